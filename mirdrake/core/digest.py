"""SHA-256 digests of contents and of plain data: for provenance, for resuming, and for caches."""

import hashlib
import json
from typing import Any


def digest(*contents: str | bytes) -> str:
    """Return the SHA-256 of texts (UTF-8) and bytes, one after the other, as 64 hexadecimal digits."""
    code = hashlib.sha256()
    for content in contents:
        code.update(content.encode() if isinstance(content, str) else content)
    return code.hexdigest()


def digest_data(data: Any) -> str:
    """Return the SHA-256 of plain data as canonical JSON: equal data have equal digests."""
    return digest(json.dumps(data, sort_keys=True, separators=(",", ":")))

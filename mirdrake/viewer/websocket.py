"""Web socket frames of a browser, and the messages among them that Meshcat may get."""

import base64
import binascii
import hashlib
import math
import struct
from collections.abc import Iterator

from mirdrake.errors import MirdrakeError

MOST = 65536
"""Bytes of a message."""

TEXT, BINARY, CLOSE, PING, PONG = 1, 2, 8, 9, 10
"""Opcodes."""

_GUID = "258EAFA5-E914-47DA-95CA-C5AB0DC85B11"
_DEPTH = 4  # of nested arrays and maps
_KINDS = {"button", "slider", "gamepad"}


class ProtocolError(MirdrakeError):
    """Bytes that are not web socket frames of a client, or not MessagePack."""


def accept_key(key: str) -> str | None:
    """Return the server's answer to a client's ``Sec-WebSocket-Key``; None if that is not a key."""
    try:
        if len(base64.b64decode(key, validate=True)) != 16:
            return None
    except (binascii.Error, ValueError):
        return None
    return base64.b64encode(hashlib.sha1((key + _GUID).encode()).digest()).decode()


class FrameReader:
    """Splits what a client sends into complete messages (RFC 6455, without extensions)."""

    def __init__(self) -> None:
        self._bytes = bytearray()
        self._message = bytearray()
        self._opcode = 0  # of the message whose fragments are being collected

    def feed(self, data: bytes) -> Iterator[tuple[int, bytes]]:
        """Yield opcode and payload of each message that is complete.

        Raises:
            ProtocolError: the bytes are not masked frames of a client, or a message is larger than :data:`MOST`.
        """
        self._bytes += data
        while (frame := self._next()) is not None:
            final, opcode, payload = frame
            if opcode >= CLOSE:
                yield opcode, payload
                continue
            if (opcode == 0) != (self._opcode != 0):
                raise ProtocolError("fragments out of order")
            self._opcode = self._opcode or opcode
            self._message += payload
            if len(self._message) > MOST:
                raise ProtocolError("message too large")
            if final:
                yield self._opcode, bytes(self._message)
                self._opcode, self._message = 0, bytearray()

    def _next(self) -> tuple[bool, int, bytes] | None:
        """Whether a frame is its message's last, its opcode and payload; None if it is not complete."""
        have = self._bytes
        if len(have) < 2:
            return None
        final, opcode, size, start = bool(have[0] & 0x80), have[0] & 0x0F, have[1] & 0x7F, 2
        if have[0] & 0x70 or opcode not in {0, TEXT, BINARY, CLOSE, PING, PONG} or not have[1] & 0x80:
            raise ProtocolError("reserved bits, unknown opcode or no mask")
        if opcode >= CLOSE and (not final or size > 125):
            raise ProtocolError("control frame too large or fragmented")
        if size >= 126:
            start += 2 if size == 126 else 8
            if len(have) < start:
                return None
            size = int.from_bytes(have[2:start], "big")
        if size > MOST:
            raise ProtocolError("frame too large")
        end = start + 4 + size
        if len(have) < end:
            return None
        mask, payload = bytes(have[start : start + 4]), bytes(have[start + 4 : end])
        del have[:end]
        pattern = int.from_bytes((mask * (size // 4 + 1))[:size], "big")
        return final, opcode, (int.from_bytes(payload, "big") ^ pattern).to_bytes(size, "big")


def make_frame(opcode: int, payload: bytes) -> bytes:
    """Return a whole message as one frame of a client, with a mask of zeros."""
    size = len(payload)
    if size < 126:
        head = bytes([0x80 | opcode, 0x80 | size])
    else:
        head = bytes([0x80 | opcode, 0x80 | 126]) + size.to_bytes(2, "big") if size < MOST else b""
    if not head:
        head = bytes([0x80 | opcode, 0x80 | 127]) + size.to_bytes(8, "big")
    return head + b"\0\0\0\0" + payload


def is_event(payload: bytes) -> bool:
    """Whether a binary message is an event of Meshcat's page: a button, a slider or a game pad.

    The camera's pose is not passed on: Meshcat's thread ends on one that is not a rotation, and nothing here reads it.
    """
    try:
        event, end = _unpack(payload, 0, _DEPTH)
    except (ProtocolError, IndexError, struct.error, UnicodeDecodeError, TypeError):
        return False
    if end != len(payload) or not isinstance(event, dict) or event.get("type") not in _KINDS:
        return False
    if not isinstance(event.get("name", ""), str) or not {"type", "name", "value", "gamepad"} >= event.keys():
        return False
    return _is_number(event.get("value", 0.0)) and _is_pad(event.get("gamepad"))


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _is_pad(pad: object) -> bool:
    if pad is None:
        return True
    if not isinstance(pad, dict) or not {"index", "button_values", "axes"} >= pad.keys():
        return False
    lists = [pad.get(key, []) for key in ("button_values", "axes")]
    index = pad.get("index")
    return (index is None or (type(index) is int and 0 <= index < 64)) and all(
        isinstance(one, list) and len(one) <= 64 and all(map(_is_number, one)) for one in lists
    )


def _unpack(data: bytes, at: int, depth: int) -> tuple[object, int]:
    """A MessagePack value and where it ends; extension types are rejected.

    Raises:
        ProtocolError, IndexError, struct.error, UnicodeDecodeError, TypeError: it is not one.
    """
    tag, at = data[at], at + 1
    if tag < 0x80 or tag >= 0xE0:
        return (tag if tag < 0x80 else tag - 256), at
    if tag in _FIXED:
        return _FIXED[tag], at
    if tag in _SCALARS:
        form = _SCALARS[tag]
        return struct.unpack_from(form, data, at)[0], at + struct.calcsize(form)
    size, width = tag & (0x1F if 0xA0 <= tag < 0xC0 else 0x0F), _WIDTHS.get(tag, 0)
    if width:
        size, at = int.from_bytes(data[at : at + width], "big"), at + width
    if size > len(data) - at:
        raise ProtocolError("longer than the message")
    if 0xA0 <= tag < 0xC0 or tag in (0xD9, 0xDA, 0xDB):
        return data[at : at + size].decode(), at + size
    if depth == 0 or not (tag < 0xA0 or tag in (0xDC, 0xDD, 0xDE, 0xDF)):
        raise ProtocolError("nested too deeply, or a type that no event has")
    items: list[object] = []
    is_map = tag < 0x90 or tag in (0xDE, 0xDF)
    for _ in range(2 * size if is_map else size):
        item, at = _unpack(data, at, depth - 1)
        items.append(item)
    return (dict(zip(items[::2], items[1::2], strict=True)) if is_map else items), at


_FIXED = {0xC0: None, 0xC2: False, 0xC3: True}
_SCALARS = {0xCA: ">f", 0xCB: ">d", 0xCC: ">B", 0xCD: ">H", 0xCE: ">I", 0xCF: ">Q"}
_SCALARS |= {0xD0: ">b", 0xD1: ">h", 0xD2: ">i", 0xD3: ">q"}
_WIDTHS = {0xD9: 1, 0xDA: 2, 0xDB: 4, 0xDC: 2, 0xDD: 4, 0xDE: 2, 0xDF: 4}

"""Settings of JupyterLab for ``make notebooks``: notebooks that Git tracks are saved without outputs, as in Git.

Elsewhere: ``jupyter lab --config=notebooks/jupyter_server_config.py notebooks``. Save a notebook under another name to
keep its outputs.
"""

import json
import subprocess
from pathlib import Path
from typing import Any

folder = Path(__file__).resolve().parent
listed = subprocess.run(["git", "ls-files", "*.ipynb"], cwd=folder, capture_output=True, text=True, check=False)
tracked = {folder / name for name in listed.stdout.splitlines()}


def remove_outputs(model: dict[str, Any], path: str, contents_manager: Any, **_: Any) -> None:
    """Remove outputs, and what a kernel adds to the metadata, from a tracked notebook before it is saved."""
    file = Path(contents_manager.root_dir, path).resolve()
    if model["type"] != "notebook" or file not in tracked:
        return
    model["content"]["metadata"] = json.loads(file.read_text(encoding="utf-8"))["metadata"]
    for cell in model["content"]["cells"]:
        if cell["cell_type"] == "code":
            cell |= {"outputs": [], "execution_count": None}


get_config().ContentsManager.pre_save_hook = remove_outputs  # noqa: F821 - Jupyter provides get_config

"""The two scripts of a page: the plotting library and what calls it, both inlined.

A page asks for nothing, so both stand in it. It says which scripts may run by their
hashes, so that no other text in it ever can: names in it are from other people's files.
"""

import base64
import hashlib
import json
from functools import cache
from importlib.util import find_spec
from pathlib import Path

from markupsafe import Markup

from residual.errors import InputError

_OWN = Path(__file__).parent / "templates" / "page.js"


@cache
def library() -> str:
    """Return the script of the plotting library, as its package has it."""
    return _packaged("plotly", "package_data", "plotly.min.js")


@cache
def scene_library() -> str:
    """Return the script that draws in 3-D, as its package has it.

    Raises:
        InputError: If that package, an extra, is not installed.
    """
    if find_spec("meshcat") is None:
        raise InputError(
            "An arm in 3-D needs MeshCat, which is not installed. It comes with the "
            'extra: pip install "modelgap[view]".'
        )
    return _packaged("meshcat", "viewer", "dist", "main.min.js")


def of_template(name: str) -> str:
    """Return a script of ours that stands beside the templates."""
    return (_OWN.parent / name).read_text(encoding="utf-8").strip()


def _packaged(package: str, *parts: str) -> str:
    # Found and not imported: only its file is needed, and importing it takes longer.
    (folder,) = find_spec(package).submodule_search_locations
    return Path(folder, *parts).read_text(encoding="utf-8").strip()


@cache
def own() -> str:
    """Return our script, which draws what a page has the data of."""
    return _OWN.read_text(encoding="utf-8").strip()


@cache
def hashes() -> tuple[str, ...]:
    """Return the scripts as a content policy names them: 'sha256-...'."""
    return tuple(hash_of(text) for text in (library(), own()))


def hash_of(script: str) -> str:
    """Return a script as a content policy names it (CSP level 3, section 2.3.1)."""
    code = hashlib.sha256(script.encode()).digest()
    return f"'sha256-{base64.b64encode(code).decode()}'"


def as_data(value: object) -> Markup:
    """Return a value as JSON that may stand within a script element.

    Args:
        value: What JSON can hold; NaN becomes null.
    """
    text = json.dumps(value, separators=(",", ":"), ensure_ascii=False)
    # None of these can end the element or begin a comment in it.
    for sign in "<>&\u2028\u2029":
        text = text.replace(sign, f"\\u{ord(sign):04x}")
    return Markup(text)

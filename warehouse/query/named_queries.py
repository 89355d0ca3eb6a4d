"""Named queries of frequent questions, as named.toml beside this file has them."""

import tomllib
from pathlib import Path

_FILE = Path(__file__).with_name("named.toml")
_CONTENT = tomllib.loads(_FILE.read_text(encoding="utf-8"))

# What each answers, and its SQL.
NAMED = {name: (each["about"], each["sql"]) for name, each in _CONTENT.items()}
# Values that a query needs, by query.
TAKES = {name: each.get("takes", {}) for name, each in _CONTENT.items()}

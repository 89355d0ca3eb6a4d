"""Known vulnerabilities of the locked packages, licences of the installed ones.

    .venv/bin/python scripts/audit.py requirements-dev.lock

Exit codes: 0 nothing found, 1 a package is known to be vulnerable, 3 nobody could be
asked, which is no clean answer. A licence to look at is told and changes no code.
"""

import json
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterable
from importlib.metadata import Distribution, distributions
from pathlib import Path

CLEAN, VULNERABLE, NOT_ASKED = 0, 1, 3
LONGEST = 900  # seconds
Run = Callable[..., subprocess.CompletedProcess]

# Words of licences that ask nothing of who uses a package but to keep its notice.
_PERMISSIVE = (
    *("mit", "bsd", "apache", "isc", "psf", "python software foundation", "0bsd"),
    *("zlib", "unlicense", "public domain", "hpnd", "cc0", "boost", "bsl-1.0"),
)
_NOT = ("gpl", "mpl", "mozilla", "epl", "eupl", "cddl", "proprietary", "commercial")


def audit(lock: Path, run: Run = subprocess.run) -> tuple[int, list[str]]:
    """Ask for the known vulnerabilities of what a lock file pins."""
    tool = shutil.which("pip-audit")
    if tool is None and run is subprocess.run:
        return NOT_ASKED, [_not_asked("pip-audit is not on the PATH (pipx has it)")]
    words = [tool or "pip-audit", "--requirement", str(lock), "--require-hashes"]
    words += ["--disable-pip", "--progress-spinner", "off", "--format", "json"]
    try:
        done = run(words, capture_output=True, text=True, timeout=LONGEST)
    except (OSError, subprocess.TimeoutExpired) as error:
        return NOT_ASKED, [_not_asked(str(error))]
    try:
        packages = json.loads(done.stdout)["dependencies"]
    except (ValueError, KeyError, TypeError):
        last = (done.stderr.strip().splitlines() or ["no answer"])[-1]
        return NOT_ASKED, [_not_asked(last[:200])]
    return _told(packages)


def _told(packages: list[dict]) -> tuple[int, list[str]]:
    skipped = [p for p in packages if "skip_reason" in p]
    lines = [
        f"{p['name']} {p['version']}: {v['id']}, mended in "
        f"{', '.join(v['fix_versions']) or 'no version yet'}"
        for p in packages
        for v in p.get("vulns", ())
    ]
    asked = len(packages) - len(skipped)
    found = bool(lines)
    lines.append(f"{asked} packages asked for, {len(lines)} known vulnerabilities")
    if skipped or not asked:
        names = ", ".join(p["name"] for p in skipped)
        lines.append(_not_asked(f"no answer about {names or 'any package'}"))
    code = NOT_ASKED if skipped or not asked else CLEAN
    return (VULNERABLE if found else code), lines


def _not_asked(why: str) -> str:
    return f"vulnerabilities: NOT CHECKED, the advisories could not be asked: {why}"


def licences(installed: Iterable[Distribution]) -> list[str]:
    """Return a line per licence with its packages, those to look at marked."""
    packages: dict[str, list[str]] = {}
    for each in installed:
        packages.setdefault(_licence(each), []).append(each.metadata["Name"])
    return [
        f"{' ' if _permissive(name) else '!'} {name}: {', '.join(sorted(set(names)))}"
        for name, names in sorted(packages.items())
    ]


def _licence(package: Distribution) -> str:
    """Its expression, else its classifiers, else the first line of its text."""
    about = package.metadata
    stated = [
        text.rpartition("::")[2].strip()
        for text in about.get_all("Classifier") or ()
        if text.startswith("License ::") and not text.endswith("OSI Approved")
    ]
    text = (about.get("License") or "").strip().splitlines()
    return (
        about.get("License-Expression")
        or "; ".join(stated)
        or (text[0][:60] if text else "not stated")
    )


def _permissive(licence: str) -> bool:
    small = licence.lower()
    return any(w in small for w in _PERMISSIVE) and not any(w in small for w in _NOT)


def main() -> int:
    """Print licences and vulnerabilities and return the exit code."""
    print("licences (! is one to look at):")
    print("\n".join(licences(distributions())))
    code, lines = audit(Path(sys.argv[1]))
    print("\n".join(lines))
    return code


if __name__ == "__main__":
    sys.exit(main())

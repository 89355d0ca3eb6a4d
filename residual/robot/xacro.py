"""A xacro, expanded to a URDF by xacrodoc."""

from collections.abc import Sequence
from pathlib import Path

from residual.errors import InputError, RobotError, not_installed, shortened


def read_xacro(path: Path, args: Sequence[str], packages: Sequence[str]) -> str:
    """Expand a xacro.

    Args:
        args: Its arguments, as "name:=value".
        packages: Folders of packages, or such packages themselves, where $(find name)
            looks before the folders above the file.

    Raises:
        RobotError: If it does not expand.
        InputError: If an argument is none, or xacrodoc is not installed.
    """
    try:
        from xacrodoc import XacroDoc
        from xacrodoc import packages as finder
    except ImportError as error:
        raise not_installed("xacrodoc") from error
    arguments = {}
    for word in args:
        name, sign, value = word.partition(":=")
        if not sign or not name:
            raise InputError(
                f"--xacro-arg '{shortened(word)}': expected name:=value, such as "
                "ur_type:=ur5e."
            )
        arguments[name] = value
    finder.reset()
    # A folder is a package by its name too, with or without a package.xml.
    above = list(path.resolve().parents)
    places = [*reversed(above), *(Path(p).resolve() for p in packages)]
    beside = [p for folder in (*packages, *above[:3]) for p in Path(folder).iterdir()]
    folders = {p.name: p for p in (*reversed(beside), *places) if p.is_dir()}
    finder.update_package_cache(folders)
    try:
        # Meshes are nobody's concern here, and their folders no part of the robot.
        document = XacroDoc.from_file(path, subargs=arguments, resolve_packages=False)
        return document.dom.toxml()
    except Exception as error:
        # What a macro makes the parser raise is not on any list.
        why = shortened(" ".join(str(error).split()) or type(error).__name__)
        raise RobotError(
            f"{path.name} does not expand: {why} Arguments are given by --xacro-arg "
            "name:=value, folders of packages by --package-dir."
        ) from error

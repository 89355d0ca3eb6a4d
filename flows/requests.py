"""The request of each command: one frozen record, whose fields are the options.

The command line takes a record as its options, with the help texts below; positional
arguments are set by the command. The record of a stored result holds its request, which
says how to repeat it; store and column map are not part of that.
"""

import re
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, fields
from pathlib import Path
from typing import Annotated, Any, Literal, Self, get_args, get_type_hints

from cyclopts import Parameter, Token

from residual.errors import InputError

_PLACES = ("columns", "store")
_OF_ROBOT = ("chain", "tip", "xacro_args", "package_dirs")  # go into the robot word


# A switch without a value; there is no --no-switch.
Flag = Annotated[bool, Parameter(negative="")]
# Takes all following words up to the next option; at least one.
Words = Annotated[
    tuple[str, ...], Parameter(consume_multiple=(1, None), negative="", metavar="LOG...")
]
# One word at a time; the option may be repeated.
Tags = Annotated[tuple[str, ...], Parameter(negative="", metavar="TAG")]
LONGEST_WORD = 60
_KEY = re.compile(r"[\w.-]+")
# A positional argument.
Log = Annotated[str, Parameter(name="LOG")]
# The name of a value in the help.
File = Annotated[str | None, Parameter(metavar="FILE")]
Folder = Annotated[str | None, Parameter(metavar="FOLDER")]
# Where a result goes, with the names that the option had before.
OutFolder = Annotated[str | None, Parameter(name=("--out", "--export"), metavar="FOLDER")]
Id = Annotated[str | None, Parameter(metavar="ID")]
Name = Annotated[str | None, Parameter(metavar="NAME")]
Model = Annotated[str | None, Parameter(metavar="MODEL")]
RobotName = Annotated[str | None, Parameter(metavar="ROBOT")]
Text = Annotated[str, Parameter(metavar="TEXT")]
Seconds = Annotated[float, Parameter(metavar="SECONDS")]
Hertz = Annotated[float, Parameter(metavar="HERTZ")]
Number = Annotated[int, Parameter(metavar="NUMBER")]
Count = Annotated[int | None, Parameter(metavar="COUNT")]
# Set by the command, no option.
GivenWord = Annotated[str, Parameter(parse=False)]
GivenWords = Annotated[tuple[str, ...], Parameter(parse=False)]


def parse_declared(_: Any, tokens: Sequence[Token]) -> tuple[str, ...]:
    """Return the names in "a,b", () for "none"."""
    text = tokens[0].value
    if text.strip() == "none":
        return ()
    return tuple(dict.fromkeys(name.strip() for name in text.split(",")))


def parse_numbers(_: Any, tokens: Sequence[Token]) -> tuple[int, ...]:
    """Return the whole numbers in "1,2,3"; InputError for anything else."""
    text = tokens[0].value
    try:
        return tuple(int(word) for word in text.split(","))
    except ValueError as error:
        raise InputError(
            f"{tokens[0].keyword} {text}: expected whole numbers, such as 1,2,3."
        ) from error


# Options of several commands.
Store = Annotated[
    str | Path | None,
    Parameter(metavar="FOLDER", help="Folder of the store; default $MODELGAP_STORE, else ./store."),
]
RobotWord = Annotated[
    str,
    Parameter(
        metavar="ROBOT",
        help="Built-in name (irb140), robot file (URDF, .xacro, MJCF .xml), or folder "
        "with one and an optional robot.toml.",
    ),
]
Columns = Annotated[
    str | None,
    Parameter(
        name="--map",
        metavar="FILE",
        help="TOML file with the meaning and the unit of each column (COLUMNS.toml).",
    ),
]
Declared = Annotated[
    tuple[str, ...] | None,
    Parameter(
        converter=parse_declared,
        n_tokens=1,
        negative="",
        metavar="EFFECT",
        help='Effects of the nominal model, as a,b; "none" for rigid bodies only. '
        "Default: the list of the robot, else viscous,coulomb,rotor_inertia.",
    ),
]
Numbers = Annotated[
    tuple[int, ...] | None,
    Parameter(converter=parse_numbers, n_tokens=1, negative="", metavar="1,2,3"),
]
TrustLog = Annotated[Flag, Parameter(help="Continue despite a certain fault of the logs.")]
Which = Annotated[
    str | None,
    Parameter(
        metavar="NAME", help="Model of a diagnosis: nominal, identified or augmented (default)."
    ),
]
ModelWord = Annotated[
    str,
    Parameter(metavar="MODEL", help="Id of a stored diagnosis or model, or a saved model file."),
]
HeldOut = Annotated[
    Words,
    Parameter(
        name="--holdout",
        help="Held-out logs, which are not fitted. Default: the last quarter of the longest log.",
    ),
]
Where = Annotated[
    str | None,
    Parameter(
        metavar="CONDITION",
        help="Also the stored runs that meet a SQL condition on the view runs, such as "
        "\"campaign = 'night' AND trajectory = 'fourier'\"; without those in quarantine.",
    ),
]
HeldOutWhere = Annotated[
    str | None,
    Parameter(
        name="--holdout-where",
        metavar="CONDITION",
        help="Held-out runs by a SQL condition, as --where.",
    ),
]
Report = Annotated[str | None, Parameter(metavar="FILE", help="HTML file for the report.")]
RecordId = Annotated[str, Parameter(help="Id of the record, or its beginning.")]
_CSV = "CSV file for a controller: t (s), q1... (rad), qd1... (rad/s), qdd1... (rad/s^2)."
Program = Annotated[str | None, Parameter(metavar="FILE", help=_CSV)]
_FORMAT = Parameter(metavar="NAME", help="Format of the output.")
Format = Annotated[Literal["table", "csv", "json", "parquet"], _FORMAT]
TextFormat = Annotated[Literal["text", "json"], _FORMAT]
TableFormat = Annotated[Literal["table", "json"], _FORMAT]
Json = Annotated[
    str | None, Parameter(metavar="FILE", help='File for the result as JSON; "-" prints it alone.')
]


@Parameter(name="*")
class Request:
    """Base class of requests."""

    __slots__ = ()

    def to_record(self) -> dict:
        """Return the request as JSON values, its name as `step`, without places."""
        left_out = (*_PLACES, *_OF_ROBOT)
        names = [f.name for f in fields(self) if f.name not in left_out]
        return {"step": self.command} | {name: getattr(self, name) for name in names}

    @property
    def command(self) -> str:
        """Name of the command."""
        return type(self).__name__.lower()

    @classmethod
    def from_record(cls, record: Mapping, store: Path) -> Self:
        """Return a request of `to_record`, for the runs of another store."""
        known = {f.name for f in fields(cls)} & set(record)
        values = {name: record[name] for name in known}
        lists = {k: tuple(v) for k, v in values.items() if isinstance(v, list)}
        return cls(**values | lists, store=store)

    @property
    def instead(self) -> str | None:
        """The option that replaces the adopted model, None for none."""
        for name in ("baseline", "paper"):
            if getattr(self, name, None):
                return f"--{name}"
        return None if getattr(self, "declared", None) is None else "--declared"


def format_command(request: Request, *more: str) -> str:
    """Return the command line of a request about logs, with more words at its end."""
    words = ["modelgap", request.command, *request.logs]
    hints = get_type_hints(type(request), include_extras=True)
    for each in fields(request):
        value, parts = getattr(request, each.name), get_args(hints[each.name])
        parameter = Parameter.combine(*(p for p in parts if isinstance(p, Parameter)))
        if parameter.parse is False or value in (None, each.default):
            continue
        (option, *_) = parameter.name or (f"--{each.name.replace('_', '-')}",)
        if value is True:
            words.append(option)
        elif isinstance(value, tuple) and not parameter.converter:
            words += [word for one in value for word in (option, one)]
        else:
            text = value if isinstance(value, str | Path) else ",".join(value) or "none"
            words += [option, str(text)]
    return shlex.join([*words, *more])


@dataclass(frozen=True, slots=True)
class RobotRequest(Request):
    """A request about one robot; the options of its file go into the robot word."""

    _: KW_ONLY
    robot: RobotWord
    chain: Annotated[
        tuple[str, ...],
        Parameter(
            converter=parse_declared,
            n_tokens=1,
            negative="",
            show_default=False,
            metavar="A,B,C",
            help="Joints of the arm by name, a,b,c; all others are locked. Default: "
            "the joints that the log names, else the only chain.",
        ),
    ] = ()
    tip: Annotated[
        str | None, Parameter(metavar="LINK", help="Last link of the arm, instead of --chain.")
    ] = None
    xacro_args: Annotated[
        Tags,
        Parameter(
            name="--xacro-arg",
            metavar="NAME:=VALUE",
            show_default=False,
            help="Argument of a xacro file; may be repeated.",
        ),
    ] = ()
    package_dirs: Annotated[
        Tags,
        Parameter(
            name="--package-dir",
            metavar="FOLDER",
            show_default=False,
            help="Folder with ROS packages for a xacro file; may be repeated.",
        ),
    ] = ()

    def __post_init__(self) -> None:
        how = [getattr(self, name) for name in _OF_ROBOT]
        if any(how) and self.robot:
            from residual.robot.robot import format_robot_reference

            object.__setattr__(self, "robot", format_robot_reference(self.robot, *how))
            for field in fields(RobotRequest)[1:]:
                object.__setattr__(self, field.name, field.default)


@dataclass(frozen=True, slots=True)
class Check(RobotRequest):
    """Check logs.

    Attributes:
        known: A value that is known for sure, such as payload.mass=0.5 (kg): it fixes
            the torque of drives that have no sensor; may be repeated.
    """

    logs: GivenWords = ()
    _: KW_ONLY
    columns: Columns = None
    known: Annotated[Tags, Parameter(metavar="EFFECT=VALUE")] = ()
    store: Store = None


@dataclass(frozen=True, slots=True)
class Diagnose(RobotRequest):
    """Diagnose logs.

    Attributes:
        baseline: Logs of healthy runs of the robot; then only changes are named.
        trust_log: Continue although a fault of the logs is certain (modelgap check);
            what is named may be due to it.
        known: A value that is known for sure, such as payload.mass=2.8 (kg) of a
            weighed load, coulomb.2.level=8 or link.3.mass=4.1; may be repeated.
        model: "nominal", or the id of the diagnosis whose model is tested. Default: the
            adopted model of the robot (modelgap models), for stored runs or with
            --store.
    """

    logs: GivenWords = ()
    _: KW_ONLY
    baseline: Words = ()
    held_out: HeldOut = ()
    declared: Declared = None
    columns: Columns = None
    known: Annotated[Tags, Parameter(metavar="EFFECT=VALUE")] = ()
    store: Store = None
    trust_log: Flag = False
    model: Model = None


@dataclass(frozen=True, slots=True)
class Identify(RobotRequest):
    """Identify a model from logs.

    Attributes:
        method: Weights of the rows: ols (equal), wls (by the noise of the joint), irls
            (less for outliers).
        prior: Relative standard deviation of the nominal values, such as 0.03; without
            it the fit is free.
        consistent: Also find physically consistent parameters: positive masses and
            pseudo-inertias, nearest to the nominal.
        model: Start model: nominal, or the id of a diagnosis or an adoption. Default on
            stored runs: the adopted model of the robot, its effects fitted too.
    """

    logs: GivenWords = ()
    _: KW_ONLY
    held_out: HeldOut = ()
    method: Annotated[str, Parameter(metavar="NAME")] = "wls"
    declared: Declared = None
    prior: Annotated[float | None, Parameter(metavar="SHARE")] = None
    consistent: Flag = False
    columns: Columns = None
    store: Store = None
    trust_log: TrustLog = False
    model: Model = None


@dataclass(frozen=True, slots=True)
class Calibrate(RobotRequest):
    """Fit look-up tables to logs.

    Attributes:
        paper: As in the paper: states of the reference of joints 1 to 3, errors against
            the simulated twin. Needs logs with a reference (q_ref), on which the twin
            of a measured log is simulated.
        levels: Levels of the paper form: one number, or one per variable, such as
            8,8,8,22,22,22,2,2,2. Default: 22.
        components: Components of the paper form. Default: the number, up to 30, with
            the smallest error on runs left out.
        joints: Joints of states and torques, such as 1,2,3. Default: all; with --paper
            the first three.
    """

    logs: GivenWords = ()
    _: KW_ONLY
    paper: Flag = False
    declared: Declared = None
    columns: Columns = None
    store: Store = None
    trust_log: TrustLog = False
    levels: Numbers = None
    components: Count = None
    joints: Numbers = None


@dataclass(frozen=True, slots=True)
class Import(RobotRequest):
    """Import logs as runs of the store.

    Attributes:
        columns: TOML file with the meaning and the unit of each column; for bags also
            the topic and the joint names.
        trajectory: Name of the kind of motion, for queries.
        kind: Name of the purpose of the log, for queries.
        serial: Serial number of the arm, as in its robot.toml; runs of arms with other
            serial numbers are kept apart.
        tags: A word, or KEY=VALUE, such as cell=4; may be repeated.
        recorded_at: Time of the first sample, such as 2026-11-20T14:03:00+01:00.
            Default: the clock of a bag or MCAP, a line above the table, recorded_at in
            the metadata of Parquet, or a column of time since 1970.
    """

    logs: GivenWords = ()
    _: KW_ONLY
    columns: Annotated[File, Parameter(name="--map")] = None
    trajectory: Name = None
    kind: Annotated[str, Parameter(metavar="NAME")] = "log"
    store: Store = None
    trust_log: TrustLog = False
    serial: Name = None
    tags: Annotated[Tags, Parameter(name="--tag")] = ()
    recorded_at: Annotated[str | None, Parameter(metavar="DATE")] = None


@dataclass(frozen=True, slots=True)
class Validate(Request):
    """Validate models on a run.

    Attributes:
        run: Id of the run, or its beginning.
        window: Length of the windows in seconds; errors grow quickly with it.
        model: Id of a diagnosis, a model or a calibration (its look-up tables) to try
            beside the nominal model and the one that the robot has (modelgap models);
            "nominal" for neither.
        adopted: Id of the diagnosis whose model the robot has, "nominal" for none; None
            for what the store says now.
    """

    run: GivenWord = ""
    window: Seconds = 0.25
    store: Store = None
    model: Model = None
    adopted: Annotated[str | None, Parameter(parse=False)] = None


@dataclass(frozen=True, slots=True)
class Monitor(Request):
    """Monitor the sensors of runs.

    Attributes:
        model: Id of a diagnosis, or a robot for its nominal model.
        runs: Ids of the runs.
        good: Ids of healthy runs, three or more. Default: the runs of the diagnosis.
        per_hour: Largest rate of false alarms per hour.
    """

    model: GivenWord = ""
    runs: GivenWords = ()
    good: Annotated[Words, Parameter(name="--calibrate", metavar="RUN...")] = ()
    per_hour: Annotated[float, Parameter(metavar="COUNT")] = 1.0
    store: Store = None


@dataclass(frozen=True, slots=True)
class Next(RobotRequest):
    """Choose the next motion for a verdict.

    Attributes:
        verdict: Id of a stored diagnosis, or a JSON file with a verdict.
        baseline: Logs of healthy runs of that diagnosis.
        held_out: Held-out logs of that diagnosis.
        seconds: Length of the motion in seconds, 4 to 600.
        seed: Seed of the motions.
    """

    verdict: GivenWord = ""
    logs: GivenWords = ()
    _: KW_ONLY
    robot: RobotWord | None = None
    baseline: Words = ()
    held_out: Annotated[Words, Parameter(name="--holdout")] = ()
    seconds: Seconds = 20.0
    seed: Number = 0
    columns: Columns = None
    store: Store = None


def check_tags(tags: Sequence[str]) -> list[str]:
    """Return tags in the order of the alphabet, each once."""
    values: dict[str, str] = {}
    for tag in tags:
        key, _, _ = tag.partition("=")
        if not is_short_word(tag) or not _KEY.fullmatch(key):
            raise InputError(
                f"tag '{tag[:LONGEST_WORD]}': expected a word, or KEY=VALUE, such as "
                "cell=4; a key has letters, digits, '.', '_' and '-'."
            )
        if values.setdefault(key, tag) != tag:
            raise InputError(f"tags '{values[key]}' and '{tag}' set one key twice. Keep one.")
    return sorted(values.values())


def is_short_word(word: str) -> bool:
    """Return whether a word is short and printable."""
    return 0 < len(word) <= LONGEST_WORD and word.isprintable() and word == word.strip()

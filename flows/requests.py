"""What a user wants of each verb: one frozen record per verb, its fields the options.

The command line takes a record as its options, with the meanings that stand here; words
that stand on the line by their place are handed over by the command. Of what is stored,
the record of its request says how to make it again; where things are (store, map of
columns) is no part of that.
"""

from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, fields
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from cyclopts import Parameter, Token

from residual.errors import InputError
from residual.robot.word import word_of

_PLACES = ("columns", "store")
# Options that go into the word for the robot (`residual.robot.robot.word_of`).
_OF_ROBOT = ("chain", "tip", "xacro_args", "package_dirs")


# A switch without a value; there is no --no-switch.
Flag = Annotated[bool, Parameter(negative="")]
# Takes all following words up to the next option; at least one.
Words = Annotated[
    tuple[str, ...],
    Parameter(consume_multiple=(1, None), negative="", metavar="LOG..."),
]
# One word at a time; the option may be given again.
Tags = Annotated[tuple[str, ...], Parameter(negative="", metavar="TAG")]
# What stands on the line by its place.
Log = Annotated[str, Parameter(name="LOG")]
# What the word behind an option is, as help shows it.
File = Annotated[str | None, Parameter(metavar="FILE")]
Folder = Annotated[str | None, Parameter(metavar="FOLDER")]
Id = Annotated[str | None, Parameter(metavar="ID")]
Name = Annotated[str | None, Parameter(metavar="NAME")]
Model = Annotated[str | None, Parameter(metavar="MODEL")]
RobotName = Annotated[str | None, Parameter(metavar="ROBOT")]
Text = Annotated[str, Parameter(metavar="TEXT")]
Seconds = Annotated[float, Parameter(metavar="SECONDS")]
Hertz = Annotated[float, Parameter(metavar="HERTZ")]
Number = Annotated[int, Parameter(metavar="NUMBER")]
Count = Annotated[int | None, Parameter(metavar="COUNT")]
# How an answer of the store is printed.
Format = Annotated[
    Literal["table", "csv", "json", "parquet"], Parameter(metavar="NAME")
]
GivenWord = Annotated[str, Parameter(parse=False)]
GivenWords = Annotated[tuple[str, ...], Parameter(parse=False)]


def parse_declared(_: Any, tokens: Sequence[Token]) -> tuple[str, ...]:
    """Return the names in "a,b", () for "none"."""
    text = tokens[0].value
    if text.strip() == "none":
        return ()
    return tuple(dict.fromkeys(name.strip() for name in text.split(",")))


def parse_numbers(_: Any, tokens: Sequence[Token]) -> tuple[int, ...]:
    """Return the whole numbers in "1,2,3".

    Raises:
        InputError: If one is no whole number.
    """
    text = tokens[0].value
    try:
        return tuple(int(word) for word in text.split(","))
    except ValueError as error:
        raise InputError(
            f"{tokens[0].keyword} {text}: expected whole numbers, as 1,2,3."
        ) from error


# Options that many commands have, each explained here and nowhere else.
Store = Annotated[
    str | Path | None,
    Parameter(
        metavar="FOLDER",
        help="Folder of the store; else $MODELGAP_STORE, else ./store.",
    ),
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
        help="TOML file that says which column is what, in which unit.",
    ),
]
Declared = Annotated[
    tuple[str, ...] | None,
    Parameter(
        converter=parse_declared,
        n_tokens=1,
        negative="",
        metavar="EFFECT",
        help='Effects that the model has, as a,b; "none" for a bare rigid body. '
        "Without it the robot's own list, or viscous,coulomb,rotor_inertia.",
    ),
]
Numbers = Annotated[
    tuple[int, ...] | None,
    Parameter(converter=parse_numbers, n_tokens=1, negative="", metavar="1,2,3"),
]
TrustLog = Annotated[
    Flag,
    Parameter(help="Go on although a fault of the logs is certain (modelgap check)."),
]
Which = Annotated[
    str | None,
    Parameter(
        metavar="NAME",
        help="Which model of a diagnosis: nominal, identified or augmented, which is "
        "the usual one.",
    ),
]
ModelWord = Annotated[
    str,
    Parameter(
        metavar="MODEL",
        help="Id of a diagnosis or model of the store, or a file that a model was "
        "saved into.",
    ),
]
HeldOut = Annotated[
    Words,
    Parameter(
        name="--holdout",
        help="Logs for the proof. Without them the last quarter of the longest log.",
    ),
]
Where = Annotated[
    str | None,
    Parameter(
        metavar="CONDITION",
        help="Also the runs of the store that fulfil a condition over the view runs, "
        "such as \"campaign = 'night' AND trajectory = 'fourier'\" (modelgap sql "
        "--schema); not those in quarantine.",
    ),
]
HeldOutWhere = Annotated[
    str | None,
    Parameter(
        name="--holdout-where",
        metavar="CONDITION",
        help="The same for --holdout.",
    ),
]
Json = Annotated[
    str | None,
    Parameter(
        metavar="FILE",
        help='File for the outcome as JSON; "-" prints it and nothing else.',
    ),
]


@Parameter(name="*")
class Request:
    """A verb and what it is to be done with."""

    __slots__ = ()

    def to_record(self) -> dict:
        """Return the request as JSON can hold it: the verb as `step`, no places."""
        left_out = (*_PLACES, *_OF_ROBOT)
        names = [f.name for f in fields(self) if f.name not in left_out]
        step = type(self).__name__.lower()
        return {"step": step} | {name: getattr(self, name) for name in names}

    @property
    def command(self) -> str:
        """The command that takes it."""
        return type(self).__name__.lower()

    @classmethod
    def from_record(cls, record: Mapping, store: Path) -> Self:
        """Return the request that `to_record` was called on, for another store.

        Args:
            record: The record; what is no part of the request is left alone.
            store: Where its runs are, and where what is made is kept.
        """
        known = {f.name for f in fields(cls)} & set(record)
        values = {name: record[name] for name in known}
        lists = {k: tuple(v) for k, v in values.items() if isinstance(v, list)}
        return cls(**values | lists, store=store)

    @property
    def instead(self) -> str | None:
        """The option that says by itself what the nominal model is, None for none."""
        for name in ("baseline", "paper"):
            if getattr(self, name, None):
                return f"--{name}"
        return None if getattr(self, "declared", None) is None else "--declared"


@dataclass(frozen=True, slots=True)
class OfRobot(Request):
    """What names a robot; how its file is read goes into the word for it."""

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
            help="Joints of the arm by their names in the file, a,b,c; all others are "
            "locked. Without it those that the log has by name, else the only chain.",
        ),
    ] = ()
    tip: Annotated[
        str | None,
        Parameter(
            metavar="LINK", help="Link that the arm ends with, in place of --chain."
        ),
    ] = None
    xacro_args: Annotated[
        Tags,
        Parameter(
            name="--xacro-arg",
            metavar="NAME:=VALUE",
            show_default=False,
            help="Argument of a xacro, name:=value.",
        ),
    ] = ()
    package_dirs: Annotated[
        Tags,
        Parameter(
            name="--package-dir",
            metavar="FOLDER",
            show_default=False,
            help="Folder of packages that a xacro finds.",
        ),
    ] = ()

    def __post_init__(self) -> None:
        how = [getattr(self, name) for name in _OF_ROBOT]
        if any(how) and self.robot:
            object.__setattr__(self, "robot", word_of(self.robot, *how))
            for field in fields(OfRobot)[1:]:
                object.__setattr__(self, field.name, field.default)


@dataclass(frozen=True, slots=True)
class Check(OfRobot):
    """Which logs are checked."""

    logs: GivenWords = ()
    _: KW_ONLY
    columns: Columns = None
    store: Store = None


@dataclass(frozen=True, slots=True)
class Map(OfRobot):
    """Which log a map of columns is drafted for.

    Attributes:
        format: The log's format, where it is not found out: ur-rtde, franka, kuka-fri,
            robotstudio or ros.
    """

    log: GivenWord = ""
    _: KW_ONLY
    format: Name = None


@dataclass(frozen=True, slots=True)
class Diagnose(OfRobot):
    """Which logs are diagnosed, and against which.

    Attributes:
        baseline: Logs of healthy runs of the robot; then what has changed is named.
        trust_log: Go on although a fault of the logs is certain (modelgap check); the
            answer is then "unknown", and names nothing.
        known: A value that is known for sure, such as payload.mass=2.8 (kg) of a load
            that was weighed, coulomb.2.level=8 or link.3.mass=4.1; may be given again.
        model: "nominal", or the id of a diagnosis whose model is to be doubted; without
            it the model that the robot has in the store (modelgap models), where the
            logs are runs of it or --store is given.
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
class Identify(OfRobot):
    """Which logs a model is identified from, and how.

    Attributes:
        method: ols (all rows alike), wls (each joint by its noise), irls (outliers
            count less).
        prior: How far nominal values may be off, such as 0.03; without it the fit is
            free.
        essential: Drop parameters that the logs do not need.
        consistent: Also find parameters that bodies can have: positive masses and
            pseudo-inertias, nearest to the nominal.
        model: Model to start from: the id of a diagnosis or an adoption, or nominal.
            Without it, on runs of the store, the one that the robot has (modelgap
            models), its named effects among what is fitted.
    """

    logs: GivenWords = ()
    _: KW_ONLY
    held_out: HeldOut = ()
    method: Annotated[str, Parameter(metavar="NAME")] = "wls"
    declared: Declared = None
    prior: Annotated[float | None, Parameter(metavar="SHARE")] = None
    essential: Flag = False
    consistent: Flag = False
    columns: Columns = None
    store: Store = None
    trust_log: TrustLog = False
    model: Model = None


@dataclass(frozen=True, slots=True)
class Calibrate(OfRobot):
    """Which logs look-up tables are fitted to.

    Attributes:
        paper: As the paper does it: states of the reference of joints 1 to 3, errors
            against the simulated twin; only for logs with a reference (q_ref), on which
            the twin of a measured log is simulated.
        levels: Levels of the paper form: a number for every variable, or one for each,
            as 8,8,8,22,22,22,2,2,2. Without it 22.
        components: Components of the paper form: so many are exported, and no more are
            tried. Without it 30 are tried, and as many exported as do best on runs left
            out.
        joints: Joints of states and torques, as 1,2,3. Without it all; with --paper
            the first three, as in the paper.
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
class Import(OfRobot):
    """Which logs become runs of the store.

    Attributes:
        columns: TOML file that says which column is what, in which unit; for bags which
            topic, and which joint has which name.
        trajectory: A word for the kind of motion, by which queries can group.
        kind: A word for what it was recorded for.
        serial: Serial number of the arm, as in its robot.toml: what is known of one arm
            is then kept apart from others of its kind.
        tags: A word, or KEY=VALUE, such as cell=4; may be given several times.
        recorded_at: When the first sample was taken, as 2026-11-20T14:03:00+01:00;
            without it what the log says: the clock of a bag or MCAP, a line above the
            table, recorded_at in the metadata of Parquet, a column of time since 1970.
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
    """Which run a model is tried on.

    Attributes:
        run: Id of the run, or its beginning.
        window: Length of the windows in seconds; errors grow quickly with it.
        model: Id of a diagnosis, a model or a calibration to try beside the nominal
            model; None for none.
        adopted: Id of the diagnosis whose model the robot has, "nominal" for none; None
            for what the store says now.
        calibration: Id of a calibration, whose tables are tried too; None for none.
    """

    run: GivenWord = ""
    window: Seconds = 0.25
    store: Store = None
    model: Annotated[str | None, Parameter(parse=False)] = None
    adopted: Annotated[str | None, Parameter(parse=False)] = None
    calibration: Annotated[str | None, Parameter(parse=False)] = None


@dataclass(frozen=True, slots=True)
class Monitor(Request):
    """Which runs are watched, and by which.

    Attributes:
        model: Id of a diagnosis, or a robot for its nominal model.
        runs: Ids of the runs to watch.
        good: Ids of healthy runs, three or more; without it those that the
            diagnosis was made from.
        per_hour: False alarms wanted at most in an hour.
    """

    model: GivenWord = ""
    runs: GivenWords = ()
    good: Annotated[Words, Parameter(name="--calibrate", metavar="RUN...")] = ()
    per_hour: Annotated[float, Parameter(metavar="COUNT")] = 1.0
    store: Store = None


@dataclass(frozen=True, slots=True)
class Next(OfRobot):
    """For which verdict a motion is chosen.

    Attributes:
        verdict: Id of a diagnosis in the store, or a JSON file with a verdict.
        baseline: Their logs of healthy runs.
        held_out: Their logs for the proof.
        seconds: Length of the motion, 4 to 600.
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


@dataclass(frozen=True, slots=True)
class Campaign(Request):
    """Many experiments of one file.

    Attributes:
        path: The campaign file.
        held_out: Kind of motion of the runs that are held out; "" for none.
        seed: Replaces the seed of the file; None for that one.
    """

    path: GivenWord = ""
    held_out: GivenWord = ""
    seed: Annotated[int | None, Parameter(parse=False)] = None
    store: Store = None


@dataclass(frozen=True, slots=True)
class Export(Request):
    """Which model is written in the form of which program.

    Attributes:
        to: The target.
        log: With rrd: a log of the robot (FILE, FILE@0:16.5, or the id of a run), to
            see its torque and what the model leaves of it.
        columns: TOML file that says which column of the log is what, in which unit.
    """

    model: GivenWord = ""
    _: KW_ONLY
    to: Annotated[str, Parameter(metavar="NAME")]
    which: Which = None
    log: Annotated[str | None, Parameter(metavar="LOG")] = None
    columns: Annotated[File, Parameter(name="--map")] = None
    store: Store = None


@dataclass(frozen=True, slots=True)
class Predict(Request):
    """Which model is asked for its torque, and on which logs.

    Attributes:
        without: Effects to take out, as NAME or NAME@JOINT; without a joint all of
            that name.
    """

    logs: GivenWords = ()
    _: KW_ONLY
    model: ModelWord
    which: Which = None
    without: Annotated[Words, Parameter(metavar="EFFECT...")] = ()
    columns: Columns = None
    store: Store = None

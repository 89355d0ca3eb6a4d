"""Every kind of record, and every column that SQL shows, with type, unit and meaning.

They are said here and only here.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import pyarrow as pa

from residual.errors import InputError

TEXT, NUMBER, WHOLE, FLAG = pa.string(), pa.float64(), pa.int64(), pa.bool_()
TIME = pa.timestamp("us")
JOINT = pa.int32()

# The view samples has columns for at least as many joints, null where there are fewer.
DEFAULT_DOF = 6
STAGING, INDEX, SEALED, QUARANTINE = "_staging", "_index", "sealed", "quarantine"
SAMPLES_FILE = "part-0.parquet"


@dataclass(frozen=True, slots=True)
class Column:
    """One column of a view."""

    name: str
    type: pa.DataType
    about: str
    # As text; "by row" or "by metric" where its row says it, None where it is no
    # quantity.
    unit: str | None = None

    @property
    def field(self) -> pa.Field:
        """The Arrow field, its unit in the metadata."""
        metadata = {"unit": self.unit} if self.unit else None
        return pa.field(self.name, self.type, metadata=metadata)


@dataclass(frozen=True, slots=True)
class Signal:
    """One quantity of the samples; per joint it has the columns q1, q2, ..."""

    unit: str
    per_joint: bool
    about: str


SIGNALS = {
    "t": Signal("s", False, "time of the sample, increasing"),
    "q": Signal("rad", True, "joint position, link side"),
    "qd": Signal("rad/s", True, "joint velocity where logged"),
    "qdd": Signal("rad/s^2", True, "joint acceleration where logged"),
    "tau": Signal("N m", True, "measured joint torque, link side"),
    "q_ref": Signal("rad", True, "reference position where logged"),
    "e_q": Signal("rad", True, "position minus that of the nominal twin"),
    "e_qd": Signal("rad/s", True, "velocity minus that of the nominal twin"),
    "e_qdd": Signal("rad/s^2", True, "acceleration minus that of the nominal twin"),
    "e_tau": Signal("N m", True, "torque minus that of the nominal twin"),
}

# How a run came to be.
_ORIGIN = (
    Column("commit", TEXT, "commit of the code that made it; null where unknown"),
    Column("version", TEXT, "version of the program that made it"),
    Column("machine", TEXT, "system and processor that it was made on"),
    Column("campaign", TEXT, "name of its campaign; null for none"),
)
_CREATED = Column("created", TIME, "when it was committed, UTC")
_CODE = (
    Column("code_hash", TEXT, "hash of the code that made it"),
    Column("dirty", FLAG, "whether that code had uncommitted changes"),
)
_ROBOT = Column("robot", TEXT, "name of the robot")
_UNIT = Column("unit", TEXT, "unit of the value")
_OF_FINDING = (
    Column("joints", pa.list_(JOINT), "joints that this value is of; [] for all"),
    Column("parameter", TEXT, "name of the parameter"),
    Column("value", NUMBER, "its value", "by row"),
    Column("std", NUMBER, "its standard deviation", "by row"),
    _UNIT,
    Column("probability", NUMBER, "of this class of effects", "1"),
)
_SERIAL = Column("serial", TEXT, "serial number of the robot; null where none is given")
_ADOPTION = (
    Column("adoption_id", TEXT, "its number, in six digits"),
    _ROBOT,
    _SERIAL,
    Column("action", TEXT, "adopted, forced (against the gate) or rolled back"),
    Column("model_id", TEXT, "the model from then on; null for the nominal one"),
    Column("diagnosis_id", TEXT, "the diagnosis that found it"),
    Column("parent", TEXT, "the adoption before, of which it is the next version"),
    Column("who", TEXT, "name of the user who did it"),
    Column("note", TEXT, "what he wrote about it"),
    Column("before", NUMBER, "held-out error of the model before", "%"),
    Column("after", NUMBER, "held-out error of this model", "%"),
    _CREATED,
)

VIEWS: dict[str, tuple[Column, ...]] = {
    "runs": (
        Column("run_id", TEXT, "id of the run"),
        _ROBOT,
        Column("source", TEXT, "simulated or imported"),
        Column("kind", TEXT, "what it was made for, such as experiment"),
        Column("trajectory", TEXT, "kind of motion, such as fourier"),
        Column("duration_s", NUMBER, "time from first to last sample", "s"),
        Column("rows", WHOLE, "number of samples", "1"),
        Column("dof", JOINT, "number of joints"),
        Column("seed", WHOLE, "seed of the reference motion"),
        _CREATED,
        *_CODE,
        Column("data_hash", TEXT, "hash of the values of all samples"),
        _SERIAL,
        Column("recorded_at", TIME, "time of the first sample, UTC; null if unknown"),
        Column("tags", pa.list_(TEXT), "words or KEY=VALUE that it was given"),
        *_ORIGIN,
        Column("log", TEXT, "file that it was imported from; null for none"),
        Column("quarantined", FLAG, "whether a tombstone says not to use it"),
    ),
    "channels": (
        Column("run_id", TEXT, "the run"),
        Column("channel", TEXT, "name of the column in samples"),
        Column("unit", TEXT, "its unit"),
        Column("joint", JOINT, "joint from 1; null where it is not of a joint"),
    ),
    "models": (
        Column("model_id", TEXT, "id of the model"),
        _ROBOT,
        Column("stage", TEXT, "nominal, identified, augmented or calibrated"),
        _CREATED,
        *_CODE,
    ),
    "parameters": (
        Column("model_id", TEXT, "the model that has it"),
        Column("name", TEXT, "name of the base parameter, after its leading one"),
        Column("joint", JOINT, "joint of the leading one, from 1"),
        Column("value", NUMBER, "its value", "by row"),
        Column("std", NUMBER, "its deviation, null where it was not fitted", "by row"),
        Column("nominal", NUMBER, "its value in the nominal model", "by row"),
        _UNIT,
        Column("status", TEXT, "fitted, or why not"),
    ),
    "effects": (
        Column("diagnosis_id", TEXT, "the diagnosis that named it"),
        Column("order", JOINT, "place among the findings, 1 first"),
        Column("name", TEXT, "name of the effect"),
        *_OF_FINDING,
    ),
    "diagnoses": (
        Column("diagnosis_id", TEXT, "id of the diagnosis"),
        _ROBOT,
        Column("verdict", TEXT, "effects, none or unknown"),
        Column("model_id", TEXT, "the model it ends with"),
        _CREATED,
        Column("nominal_scale", NUMBER, "how far off the nominal model was", "1"),
        Column("unexplained", NUMBER, "share of the torque left unexplained", "1"),
        *_CODE,
        _SERIAL,
    ),
    "errors": (
        Column("source_id", TEXT, "the diagnosis, validation, model or run of it"),
        Column("run_id", TEXT, "the run it is taken on; null for several together"),
        Column("trajectory", TEXT, "kind of motion; null for several together"),
        Column("joint", JOINT, "joint from 1; null for all together"),
        Column(
            "stage",
            TEXT,
            "nominal, identified, consistent, augmented, plsr, twin or arm; of a "
            "calibration none, ls, plsr, paper or default",
        ),
        Column(
            "metric",
            TEXT,
            "held_out, filtered, moving [%]; rms_e_q ..., rms_open_loop_q, "
            "rms_feed_forward_q [SI]; of a calibration rmsec_, rmsev_ and rmsev_mean_ "
            "with run, family, repeats, systematic or random [%]",
        ),
        Column("value", NUMBER, "its value", "by metric"),
    ),
    "verdicts": (
        Column("diagnosis_id", TEXT, "the diagnosis"),
        _CREATED,
        _ROBOT,
        _SERIAL,
        Column("verdict", TEXT, "effects, none or unknown"),
        Column("order", JOINT, "place among the findings, 1 first; null for none"),
        Column("effect", TEXT, "name of the effect; null for none"),
        *_OF_FINDING,
        Column("run_id", TEXT, "a run that it is about; one row for each"),
        Column("role", TEXT, "what the run was to it: fit, held_out or baseline"),
        Column("trajectory", TEXT, "kind of motion of the run"),
        Column("recorded_at", TIME, "when the run was recorded, UTC; null if unknown"),
        Column("tags", pa.list_(TEXT), "words or KEY=VALUE that the run was given"),
    ),
    "validations": (
        Column("validation_id", TEXT, "id of the validation"),
        _ROBOT,
        Column("kind", TEXT, "held_out, calibration, monitor, rerun ..."),
        Column("model_id", TEXT, "the model that was tried, where it is one here"),
        _CREATED,
        Column("verdict", TEXT, "of a rerun: what is not the same, and why"),
        *_CODE,
    ),
    "blind": (
        Column("validation_id", TEXT, "id of the validation of one blind case"),
        Column("study_seed", WHOLE, "seed of the study", "1"),
        Column("case_index", WHOLE, "its number in the study, from 0", "1"),
        Column("drawn", TEXT, "what was drawn: single, pair, none or unknown"),
        Column("effect", TEXT, "name of the hidden effect; null for none"),
        Column("joints", pa.list_(JOINT), "its joints; [] for the whole arm"),
        Column(
            "size", NUMBER, "how much of it there is, where one number says it", "SI"
        ),
        _UNIT,
        Column("multiple", NUMBER, "that size in minimum detectable ones", "1"),
        Column("second_effect", TEXT, "the other effect of a pair"),
        Column("second_joints", pa.list_(JOINT), "its joints"),
        Column("second_size", NUMBER, "its size", "SI"),
        Column("second_unit", TEXT, "unit of that"),
        Column("second_multiple", NUMBER, "that size in minimum detectable ones", "1"),
        Column("verdict", TEXT, "effects, none or unknown"),
        Column("named_first", TEXT, "first name of the verdict; null for none"),
        Column("named_joints", pa.list_(JOINT), "its joints"),
        Column("named", WHOLE, "how many names there are, one per place", "1"),
        Column("outcome", TEXT, "right, class, part, wrong, nothing or flagged"),
        Column(
            "found", WHOLE, "how many hidden effects are named, class included", "1"
        ),
        Column("extra", WHOLE, "how many names are none of what is hidden", "1"),
        Column("joint_right", FLAG, "whether first name or flag is on a right joint"),
        Column("unexplained", pa.list_(JOINT), "joints with something left over"),
        Column("parameter", TEXT, "main parameter of what was rightly named"),
        Column("value", NUMBER, "its value in the verdict, SI", "SI"),
        Column("std", NUMBER, "its standard deviation there", "SI"),
        Column("truth", NUMBER, "what it is", "SI"),
        Column("z", NUMBER, "deviation in standard deviations", "1"),
        Column("error_before", NUMBER, "held-out error of the nominal model", "%"),
        Column("error_refit", NUMBER, "the same after a refit alone", "%"),
        Column("error_after", NUMBER, "with what was found", "%"),
        Column("error_oracle", NUMBER, "with the true effects fitted", "%"),
        Column("gap_closed", NUMBER, "share of refit to oracle that is closed", "1"),
        Column("experiments", WHOLE, "number of runs that were fitted", "1"),
        Column("torque_noise", NUMBER, "noise of the torque over its range", "1"),
        Column("seconds", NUMBER, "time of the diagnosis", "s"),
        Column("method_hash", TEXT, "hash of the code that diagnosed and judged"),
        Column("diagnosis_id", TEXT, "the diagnosis"),
    ),
    "alarms": (
        Column("validation_id", TEXT, "the monitoring that raised it"),
        Column("run_id", TEXT, "the run that was watched"),
        Column("time", NUMBER, "when it was raised, on the clock of the log", "s"),
        Column("joint", JOINT, "joint from 1"),
        Column("sensor", TEXT, "encoder or torque"),
        Column("fault", TEXT, "frozen, jump, drift, spikes, noise, bias or lost scale"),
        Column("kind", TEXT, "score that named it"),
        Column("score", NUMBER, "that score over its limit", "1"),
        Column("until", NUMBER, "when the last score fell below its limit", "s"),
    ),
    "reports": (
        Column("report_id", TEXT, "id of the report"),
        _ROBOT,
        Column("kind", TEXT, "what it reports"),
        _CREATED,
        *_CODE,
    ),
    "adoptions": (*_ADOPTION, *_CODE),
    "adopted": _ADOPTION,
    "decisions": (
        Column("decision_id", TEXT, "id of the decision"),
        Column("loop", TEXT, "id of the loop that decided it"),
        Column("number", WHOLE, "its place in the loop, from 1", "1"),
        _ROBOT,
        Column("serial", TEXT, "serial number of the arm"),
        Column("action", TEXT, "run, diagnose, adopt, drive or stop"),
        Column("reason", TEXT, "why, in a sentence"),
        Column("outcome", TEXT, "what came of it"),
        Column("made", TEXT, "id of the record that it left; null for none"),
        Column("seconds", NUMBER, "motion of the arm so far", "s"),
        _CREATED,
        *_CODE,
    ),
    "lineage": (
        Column("child", TEXT, "id of what was made"),
        Column("parent", TEXT, "id of what it was made from"),
        Column("role", TEXT, "what the parent was to it, such as fit or held_out"),
    ),
}

# Columns that are computed, and stored nowhere; behind those of `VIEWS`.
_RECORDED = Column(
    "recorded_at", TIME, "when its last run was recorded, UTC; null if unknown"
)
_OF_ARM = (
    Column("serial", TEXT, "serial number of the arm of its runs; null for none"),
    _RECORDED,
)
COMPUTED = {
    "models": _OF_ARM,
    "diagnoses": (_RECORDED,),
    "validations": _OF_ARM,
    "errors": (
        Column("unit", TEXT, "unit of the value; null if unknown"),
        _ROBOT,
        *_OF_ARM,
    ),
}


def sample_columns(dof: int) -> tuple[Column, ...]:
    """Return the columns of the view ``samples`` for arms of up to ``dof`` joints."""
    columns = [_ROBOT, Column("run_id", TEXT, "the run")]
    for name, signal in SIGNALS.items():
        for channel in channel_names(name, dof):
            columns.append(Column(channel, NUMBER, signal.about, signal.unit))
    return tuple(columns)


def all_views(dof: int = DEFAULT_DOF) -> dict[str, tuple[Column, ...]]:
    """Return every view with its columns, ``samples`` second as the most used."""
    first = {"runs": VIEWS["runs"], "samples": sample_columns(dof)}
    views = {**first, **VIEWS}
    return {name: (*own, *COMPUTED.get(name, ())) for name, own in views.items()}


def channel_names(signal: str, dof: int) -> tuple[str, ...]:
    """Return the columns of one signal: ("t",), or ("q1", "q2", ...)."""
    if not SIGNALS[signal].per_joint:
        return (signal,)
    return tuple(f"{signal}{joint}" for joint in range(1, dof + 1))


def arrow_schema(columns: tuple[Column, ...]) -> pa.Schema:
    """Return the Arrow schema of some columns."""
    return pa.schema([column.field for column in columns])


def rows_table(view: str, rows: Iterable[Mapping]) -> pa.Table:
    """Return a record's own rows of a view as a table: without its own id.

    Raises:
        InputError: If a row does not have the types of the view.
    """
    try:
        return pa.Table.from_pylist(list(rows), schema=arrow_schema(VIEWS[view][1:]))
    except (pa.ArrowException, TypeError, ValueError) as error:
        raise InputError(f"The rows do not fit the view {view}: {error}") from error


def nested(view: str) -> pa.DataType:
    """Return the type of a record's own rows of a view: without its own id."""
    return pa.list_(pa.struct([column.field for column in VIEWS[view][1:]]))


@dataclass(frozen=True, slots=True)
class Kind:
    """One kind of record."""

    name: str  # its name, which is that of its view
    key: str  # column with its id
    # Views whose rows lie nested in its catalogue row.
    lists: tuple[str, ...] = ("errors", "lineage")
    # Columns of that row that have a value in every record.
    needed: tuple[str, ...] = ("created",)
    # That row: columns of the view, then the nested ones.
    fields: pa.Schema = field(init=False, compare=False)
    folder: str = field(init=False)  # in the store
    row: str = field(init=False)  # the file of a record with its one catalogue row

    def __post_init__(self) -> None:
        own = [c.field for c in VIEWS[self.name] if c.name != "quarantined"]
        if self.name == "runs":
            own.append(pa.field("signals", pa.list_(TEXT)))
        rows = (pa.field(view, nested(view)) for view in self.lists)
        folder = "samples" if self.name == "runs" else self.name
        row = f"_{self.key.removesuffix('_id')}.parquet"
        object.__setattr__(self, "fields", pa.schema([*own, *rows]))
        object.__setattr__(self, "folder", folder)
        object.__setattr__(self, "row", row)


KINDS = {
    kind.name: kind
    for kind in (
        Kind(
            "runs",
            "run_id",
            needed=("created", "robot", "source", "kind", "duration_s", "rows", "dof"),
        ),
        Kind("models", "model_id", ("parameters", "errors", "lineage")),
        Kind("diagnoses", "diagnosis_id", ("effects", "errors", "lineage")),
        Kind("validations", "validation_id", ("errors", "alarms", "lineage", "blind")),
        Kind("reports", "report_id"),
        # Its id is its number: nobody else can have taken that.
        Kind("adoptions", "adoption_id", ("lineage",)),
        # Its id is made of its loop and its number, for the same reason.
        Kind("decisions", "decision_id", ("lineage",)),
    )
}

# All that a store has, by the names of its folders; nobody else writes there.
FOLDERS = frozenset(
    {STAGING, INDEX, SEALED, QUARANTINE, "made_with", "robots", "_prefect"}
    | {kind.folder for kind in KINDS.values()}
)

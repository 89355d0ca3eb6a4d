"""Every kind of record and every column of the SQL views: type, unit, meaning.

Single source of truth: no other module repeats them.
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
STAGING, INDEX, SEALED = "_staging", "_index", "sealed"
# Of runs: a mark is a file of its own, so that the run itself never changes.
QUARANTINE, OPENED = "quarantine", "opened"
SAMPLES_FILE = "part-0.parquet"


@dataclass(frozen=True, slots=True)
class ViewColumn:
    """One column of a view."""

    name: str
    type: pa.DataType
    about: str
    # As text; "by row" or "by metric" where its row says it, None where it is no
    # quantity.
    unit: str | None = None

    @property
    def to_arrow_field(self) -> pa.Field:
        """The Arrow field, its unit in the metadata."""
        metadata = {"unit": self.unit} if self.unit else None
        return pa.field(self.name, self.type, metadata=metadata)


@dataclass(frozen=True, slots=True)
class SampleSignal:
    """One quantity of the samples; per joint it has the columns q1, q2, ..."""

    unit: str
    per_joint: bool
    about: str


SIGNALS = {
    "t": SampleSignal("s", False, "time of the sample, increasing"),
    "q": SampleSignal("rad", True, "joint position, link side"),
    "qd": SampleSignal("rad/s", True, "joint velocity where logged"),
    "qdd": SampleSignal("rad/s^2", True, "joint acceleration where logged"),
    "tau": SampleSignal("N m", True, "measured joint torque, link side"),
    "q_ref": SampleSignal("rad", True, "reference position where logged"),
    "e_q": SampleSignal("rad", True, "position minus that of the nominal twin"),
    "e_qd": SampleSignal("rad/s", True, "velocity minus that of the nominal twin"),
    "e_qdd": SampleSignal(
        "rad/s^2", True, "acceleration minus that of the nominal twin"
    ),
    "e_tau": SampleSignal("N m", True, "torque minus that of the nominal twin"),
}

# How a run came to be.
_ORIGIN = (
    ViewColumn("commit", TEXT, "commit of the code that made it; null where unknown"),
    ViewColumn("version", TEXT, "version of the program that made it"),
    ViewColumn("machine", TEXT, "system and processor that it was made on"),
    ViewColumn("campaign", TEXT, "name of its campaign; null for none"),
)
_CREATED = ViewColumn("created", TIME, "when it was committed, UTC")
_CODE = (
    ViewColumn("code_hash", TEXT, "hash of the code that made it"),
    ViewColumn("dirty", FLAG, "whether that code had uncommitted changes"),
)
_ROBOT = ViewColumn("robot", TEXT, "name of the robot")
_UNIT = ViewColumn("unit", TEXT, "unit of the value")
_OF_FINDING = (
    ViewColumn("joints", pa.list_(JOINT), "joints that this value is of; [] for all"),
    ViewColumn("parameter", TEXT, "name of the parameter"),
    ViewColumn("value", NUMBER, "its value", "by row"),
    ViewColumn("std", NUMBER, "its standard deviation", "by row"),
    _UNIT,
    ViewColumn("probability", NUMBER, "of this class of effects", "1"),
)
_SERIAL = ViewColumn(
    "serial", TEXT, "serial number of the robot; null where none is given"
)
_ADOPTION = (
    ViewColumn("adoption_id", TEXT, "its number, in six digits"),
    _ROBOT,
    _SERIAL,
    ViewColumn("action", TEXT, "adopted, forced (against the gate) or rolled back"),
    ViewColumn("model_id", TEXT, "the model from then on; null for the nominal one"),
    ViewColumn("diagnosis_id", TEXT, "the diagnosis that found it"),
    ViewColumn("parent", TEXT, "the adoption before, of which it is the next version"),
    ViewColumn("who", TEXT, "name of the user who did it"),
    ViewColumn("note", TEXT, "what he wrote about it"),
    ViewColumn("before", NUMBER, "held-out error of the model before", "%"),
    ViewColumn("after", NUMBER, "held-out error of this model", "%"),
    _CREATED,
)

VIEWS: dict[str, tuple[ViewColumn, ...]] = {
    "runs": (
        ViewColumn("run_id", TEXT, "id of the run"),
        _ROBOT,
        ViewColumn("source", TEXT, "simulated or imported"),
        ViewColumn("kind", TEXT, "what it was made for, such as experiment"),
        ViewColumn("trajectory", TEXT, "kind of motion, such as fourier"),
        ViewColumn("duration_s", NUMBER, "time from first to last sample", "s"),
        ViewColumn("rows", WHOLE, "number of samples", "1"),
        ViewColumn("dof", JOINT, "number of joints"),
        ViewColumn("seed", WHOLE, "seed of the reference motion"),
        _CREATED,
        *_CODE,
        ViewColumn("data_hash", TEXT, "hash of the values of all samples"),
        _SERIAL,
        ViewColumn(
            "recorded_at", TIME, "time of the first sample, UTC; null if unknown"
        ),
        ViewColumn("tags", pa.list_(TEXT), "words or KEY=VALUE that it was given"),
        *_ORIGIN,
        ViewColumn("log", TEXT, "file that it was imported from; null for none"),
        ViewColumn("quarantined", FLAG, "whether a tombstone says not to use it"),
        ViewColumn("opened", FLAG, "whether its seal was opened by sql --truth"),
    ),
    "channels": (
        ViewColumn("run_id", TEXT, "the run"),
        ViewColumn("channel", TEXT, "name of the column in samples"),
        ViewColumn("unit", TEXT, "its unit"),
        ViewColumn("joint", JOINT, "joint from 1; null where it is not of a joint"),
    ),
    "models": (
        ViewColumn("model_id", TEXT, "id of the model"),
        _ROBOT,
        ViewColumn("stage", TEXT, "nominal, identified, augmented or calibrated"),
        _CREATED,
        *_CODE,
    ),
    "parameters": (
        ViewColumn("model_id", TEXT, "the model that has it"),
        ViewColumn("name", TEXT, "name of the base parameter, after its leading one"),
        ViewColumn("joint", JOINT, "joint of the leading one, from 1"),
        ViewColumn("value", NUMBER, "its value", "by row"),
        ViewColumn(
            "std", NUMBER, "its deviation, null where it was not fitted", "by row"
        ),
        ViewColumn("nominal", NUMBER, "its value in the nominal model", "by row"),
        _UNIT,
        ViewColumn("status", TEXT, "fitted, or why not"),
    ),
    "effects": (
        ViewColumn("diagnosis_id", TEXT, "the diagnosis that named it"),
        ViewColumn("order", JOINT, "place among the findings, 1 first"),
        ViewColumn("name", TEXT, "name of the effect"),
        *_OF_FINDING,
    ),
    "diagnoses": (
        ViewColumn("diagnosis_id", TEXT, "id of the diagnosis"),
        _ROBOT,
        ViewColumn("verdict", TEXT, "effects, none or unknown"),
        ViewColumn("model_id", TEXT, "the model it ends with"),
        _CREATED,
        ViewColumn("nominal_scale", NUMBER, "how far off the nominal model was", "1"),
        ViewColumn("unexplained", NUMBER, "share of the torque left unexplained", "1"),
        *_CODE,
        _SERIAL,
    ),
    "errors": (
        ViewColumn("source_id", TEXT, "the diagnosis, validation, model or run of it"),
        ViewColumn("run_id", TEXT, "the run it is taken on; null for several together"),
        ViewColumn("trajectory", TEXT, "kind of motion; null for several together"),
        ViewColumn("joint", JOINT, "joint from 1; null for all together"),
        ViewColumn(
            "stage",
            TEXT,
            "nominal, identified, consistent, augmented, plsr, twin or arm; of a "
            "calibration none, ls, plsr, paper or default",
        ),
        ViewColumn(
            "metric",
            TEXT,
            "held_out, filtered, moving [%]; rms_e_q ..., rms_open_loop_q, "
            "rms_feed_forward_q [SI]; of a calibration rmsec_, rmsev_ and rmsev_mean_ "
            "with run, family, repeats, systematic or random [%]",
        ),
        ViewColumn("value", NUMBER, "its value", "by metric"),
    ),
    "verdicts": (
        ViewColumn("diagnosis_id", TEXT, "the diagnosis"),
        _CREATED,
        _ROBOT,
        _SERIAL,
        ViewColumn("verdict", TEXT, "effects, none or unknown"),
        ViewColumn("order", JOINT, "place among the findings, 1 first; null for none"),
        ViewColumn("effect", TEXT, "name of the effect; null for none"),
        *_OF_FINDING,
        ViewColumn("run_id", TEXT, "a run that it is about; one row for each"),
        ViewColumn("role", TEXT, "what the run was to it: fit, held_out or baseline"),
        ViewColumn("trajectory", TEXT, "kind of motion of the run"),
        ViewColumn(
            "recorded_at", TIME, "when the run was recorded, UTC; null if unknown"
        ),
        ViewColumn("tags", pa.list_(TEXT), "words or KEY=VALUE that the run was given"),
    ),
    "validations": (
        ViewColumn("validation_id", TEXT, "id of the validation"),
        _ROBOT,
        ViewColumn("kind", TEXT, "held_out, calibration, monitor, rerun ..."),
        ViewColumn("model_id", TEXT, "the model that was tried, where it is one here"),
        _CREATED,
        ViewColumn("verdict", TEXT, "of a rerun: what is not the same, and why"),
        *_CODE,
    ),
    "alarms": (
        ViewColumn("validation_id", TEXT, "the monitoring that raised it"),
        ViewColumn("run_id", TEXT, "the run that was watched"),
        ViewColumn("time", NUMBER, "when it was raised, on the clock of the log", "s"),
        ViewColumn("joint", JOINT, "joint from 1"),
        ViewColumn("sensor", TEXT, "encoder or torque"),
        ViewColumn(
            "fault", TEXT, "frozen, jump, drift, spikes, noise, bias or lost scale"
        ),
        ViewColumn("kind", TEXT, "score that named it"),
        ViewColumn("score", NUMBER, "that score over its limit", "1"),
        ViewColumn("until", NUMBER, "when the last score fell below its limit", "s"),
    ),
    "reports": (
        ViewColumn("report_id", TEXT, "id of the report"),
        _ROBOT,
        ViewColumn("kind", TEXT, "what it reports"),
        _CREATED,
        *_CODE,
    ),
    "adoptions": (*_ADOPTION, *_CODE),
    "adopted": _ADOPTION,
    "campaigns": (
        ViewColumn("campaign_id", TEXT, "id of the campaign"),
        _ROBOT,
        ViewColumn("name", TEXT, "its name, which its runs have as campaign"),
        ViewColumn("file", TEXT, "name of its file"),
        _CREATED,
        *_CODE,
    ),
    "points": (
        ViewColumn("campaign_id", TEXT, "the campaign"),
        ViewColumn("run_id", TEXT, "the run at this point"),
        ViewColumn("axis", TEXT, "what is varied, such as trajectory.kind"),
        ViewColumn("value", NUMBER, "its value where that is a number", "by row"),
        ViewColumn("word", TEXT, "its value where that is none"),
        _UNIT,
    ),
    "timings": (
        ViewColumn("id", TEXT, "the run, model, diagnosis or validation"),
        ViewColumn("step", TEXT, "reference, plant, identify, diagnose ..."),
        ViewColumn("seconds", NUMBER, "time that the step took", "s"),
    ),
    "lineage": (
        ViewColumn("child", TEXT, "id of what was made"),
        ViewColumn("parent", TEXT, "id of what it was made from"),
        ViewColumn("role", TEXT, "what the parent was to it, such as fit or held_out"),
    ),
}

# The view of the connection of `sql --truth` alone; no other has it.
TRUTH = (
    ViewColumn("run_id", TEXT, "the simulated run"),
    ViewColumn("effect", TEXT, "name of a hidden effect"),
    ViewColumn("joints", pa.list_(JOINT), "its joints; [] for the whole arm"),
    ViewColumn("parameter", TEXT, "name of the parameter; null for none"),
    ViewColumn("value", NUMBER, "its value", "by row"),
    _UNIT,
    ViewColumn("onset", NUMBER, "time from which it acts", "s"),
    ViewColumn("sealed", FLAG, "whether no campaign of the run publishes its plant"),
)

# Columns that are computed, and stored nowhere; behind those of `VIEWS`.
_RECORDED = ViewColumn(
    "recorded_at", TIME, "when its last run was recorded, UTC; null if unknown"
)
_OF_ARM = (
    ViewColumn("serial", TEXT, "serial number of the arm of its runs; null for none"),
    _RECORDED,
)
COMPUTED = {
    "models": _OF_ARM,
    "diagnoses": (_RECORDED,),
    "validations": _OF_ARM,
    "errors": (
        ViewColumn("unit", TEXT, "unit of the value; null if unknown"),
        _ROBOT,
        *_OF_ARM,
    ),
}


def list_sample_columns(dof: int) -> tuple[ViewColumn, ...]:
    """Return the columns of the view ``samples`` for arms of up to ``dof`` joints."""
    columns = [_ROBOT, ViewColumn("run_id", TEXT, "the run")]
    for name, signal in SIGNALS.items():
        for channel in list_channel_names(name, dof):
            columns.append(ViewColumn(channel, NUMBER, signal.about, signal.unit))
    return tuple(columns)


def list_views(dof: int = DEFAULT_DOF) -> dict[str, tuple[ViewColumn, ...]]:
    """Return every view with its columns, ``samples`` second as the most used."""
    first = {"runs": VIEWS["runs"], "samples": list_sample_columns(dof)}
    views = {**first, **VIEWS}
    return {
        name: (*columns, *COMPUTED.get(name, ())) for name, columns in views.items()
    }


def list_channel_names(signal: str, dof: int) -> tuple[str, ...]:
    """Return the columns of one signal: ("t",), or ("q1", "q2", ...)."""
    if not SIGNALS[signal].per_joint:
        return (signal,)
    return tuple(f"{signal}{joint}" for joint in range(1, dof + 1))


def build_arrow_schema(columns: tuple[ViewColumn, ...]) -> pa.Schema:
    """Return the Arrow schema of some columns."""
    return pa.schema([column.to_arrow_field for column in columns])


def build_view_table(view: str, rows: Iterable[Mapping]) -> pa.Table:
    """Return a record's own rows of a view as a table: without its own id.

    Raises:
        InputError: If a row does not have the types of the view.
    """
    try:
        return pa.Table.from_pylist(
            list(rows), schema=build_arrow_schema(VIEWS[view][1:])
        )
    except (pa.ArrowException, TypeError, ValueError) as error:
        raise InputError(f"The rows do not fit the view {view}: {error}") from error


def build_nested_type(view: str) -> pa.DataType:
    """Return the type of a record's own rows of a view: without its own id."""
    return pa.list_(pa.struct([column.to_arrow_field for column in VIEWS[view][1:]]))


_NESTED = ("errors", "lineage", "timings")


@dataclass(frozen=True, slots=True)
class RecordKind:
    """One kind of record."""

    name: str  # its name, which is that of its view
    key: str  # column with its id
    # Views whose rows lie nested in its catalogue row.
    nested_views: tuple[str, ...] = _NESTED
    # That row: columns of the view, then the nested ones.
    fields: pa.Schema = field(init=False, compare=False)
    folder: str = field(init=False)  # in the store
    row: str = field(init=False)  # the file of a record with its one catalogue row

    def __post_init__(self) -> None:
        marks = ("quarantined", "opened")
        fields = [c.to_arrow_field for c in VIEWS[self.name] if c.name not in marks]
        if self.name == "runs":
            fields.append(pa.field("signals", pa.list_(TEXT)))
        rows = (pa.field(view, build_nested_type(view)) for view in self.nested_views)
        folder = "samples" if self.name == "runs" else self.name
        row = f"_{self.key.removesuffix('_id')}.parquet"
        object.__setattr__(self, "fields", pa.schema([*fields, *rows]))
        object.__setattr__(self, "folder", folder)
        object.__setattr__(self, "row", row)


KINDS = {
    kind.name: kind
    for kind in (
        RecordKind("runs", "run_id"),
        RecordKind("models", "model_id", ("parameters", *_NESTED)),
        RecordKind("diagnoses", "diagnosis_id", ("effects", *_NESTED)),
        RecordKind("validations", "validation_id", ("alarms", *_NESTED)),
        RecordKind("campaigns", "campaign_id", ("points", "lineage")),
        RecordKind("reports", "report_id"),
        # Its id is its number: nobody else can have taken that.
        RecordKind("adoptions", "adoption_id", ("lineage",)),
    )
}

# Nested rows that are no part of what the id of a record is the hash of.
NOT_HASHED = {"lineage", "timings"}
# All that a store has, by the names of its folders; nobody else writes there.
FOLDERS = frozenset(
    {STAGING, INDEX, SEALED, QUARANTINE, OPENED, "made_with", "robots", "_prefect"}
    | {kind.folder for kind in KINDS.values()}
)

"""What a column of SQL is: name, type, unit and meaning."""

from dataclasses import dataclass

import pyarrow as pa

TEXT, NUMBER, WHOLE, FLAG = pa.string(), pa.float64(), pa.int64(), pa.bool_()
TIME = pa.timestamp("us")
JOINT = pa.int32()


@dataclass(frozen=True, slots=True)
class Column:
    """One column of a view.

    Attributes:
        name: Its name.
        type: Arrow type.
        about: What it holds.
        unit: Unit as text; "by row" or "by metric" where its row says it, None where it
            is no quantity.
    """

    name: str
    type: pa.DataType
    about: str
    unit: str | None = None

    @property
    def field(self) -> pa.Field:
        """The Arrow field, its unit in the metadata."""
        metadata = {"unit": self.unit} if self.unit else None
        return pa.field(self.name, self.type, metadata=metadata)


@dataclass(frozen=True, slots=True)
class Signal:
    """One quantity of the samples.

    Attributes:
        unit: Unit as text.
        per_joint: Whether there is one column per joint: q1, q2, ...
        about: What it is.
    """

    unit: str
    per_joint: bool
    about: str

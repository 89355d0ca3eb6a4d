"""Another set of effects that the logs cannot tell from the one that was named."""

from dataclasses import dataclass

from residual.diagnosis.leftover.remainder import Number

MOTION, LOAD = "motion", "load"


@dataclass(frozen=True, slots=True)
class Place:
    """An effect and the joints that it sits on.

    Attributes:
        name: Its name.
        joints: Joints from 1; empty for the whole arm.
    """

    name: str
    joints: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Alternative:
    """A set as good as the named one.

    Attributes:
        set: Its effects, one joint each where they are local.
        nats: Its evidence less the price of its names, over that of the named set.
        separated_by: "motion" where another motion would tell; "load" where the two are
            bodies that move alike: weigh the load, or log the arm without it.
    """

    set: tuple[Place, ...]
    nats: Number
    separated_by: str

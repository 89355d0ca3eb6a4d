"""What is shown of one log: torque of the models, and a finding over its variable."""

from collections.abc import Mapping
from dataclasses import dataclass

from residual.recording import Array


@dataclass(frozen=True, eq=False, slots=True)
class LogProof:
    """Measured torque against the prediction of each model on one held-out log.

    Attributes:
        id: Label of the recording.
        t: Time from the first sample [s]. Shape (n,).
        tau: Measured torque, identification filter applied [N m]. Shape (n, dof).
        tau_hat: Filtered prediction of each model: keys nominal, identified,
            augmented, and plsr where the rest was corrected [N m]. Shapes (n, dof).
        moving: Whether that joint moves. Shape (n, dof), bool.
    """

    id: str
    t: Array
    tau: Array
    tau_hat: Mapping[str, Array]
    moving: Array


@dataclass(frozen=True, eq=False, slots=True)
class Cloud:
    """What one finding explains on one joint, over the variable that explains it.

    Attributes:
        name: Name of the effect.
        joint: Joint number from 1.
        variable: What is on the horizontal axis, with its unit: "q2 [rad]".
        x: Values of that variable. Shape (k,).
        residual: Measured minus model torque without this effect [N m]. Shape (k,).
        fitted: Contribution of the effect [N m]. Shape (k,).
        log: Label of the log of each sample. Shape (k,), str; the fit logs only.
    """

    name: str
    joint: int
    variable: str
    x: Array
    residual: Array
    fitted: Array
    log: Array

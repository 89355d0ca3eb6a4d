"""What a check found, in sentences."""

from flows.report.words.phrases import joint_words
from residual.check.report import CheckReport, FaultReport

CLEAN = "The logs are what they say they are: no fault was found."

# What each kind of fault means; docs/check.md has more.
MEANING = dict(
    torque_sign="torque counts the other way round",
    angle_sign="angles count the other way round",
    joint_order="joints are in another order",
    torque_unit="torque is in another unit",
    angle_unit="angles are in another unit",
    time_unit="time is in another unit",
    gear_ratio="a gear ratio is missing or wrong",
    torque_scale="torque is too large or too small",
    gravity_removed="the arm's weight was taken out of the torque",
    friction_removed="friction was taken out of the torque",
    commanded="torque is a command, not a measurement",
    clock="the clock cannot be right",
    spike="single samples cannot be right",
    frozen="a signal stands still",
    constant="an angle never changes",
    quantised="a signal comes in coarse steps",
    saturated="torque stays at a limit",
    delay="torque and angles are not of the same time",
    filtered="torque was smoothed before it was logged",
    velocity_mismatch="velocity is not the derivative of the angle",
    out_of_range="the arm cannot be there, or go so fast",
    lockstep="joints move only together",
    too_short="the log is too short",
    no_reversal="a joint never turns back",
    robot_file="the robot file cannot be right",
    wrong_robot="the log is of another robot",
)

# The motion that would help, most wanted first.
_MORE = {
    "too_short": "Record 20 s or more in which every joint moves to and fro.",
    "lockstep": "Move the joints apart from each other: modelgap trajectory fourier.",
    "no_reversal": "Let each joint move to and fro, several times.",
}


def summary(report: CheckReport) -> str:
    """Return the answer in one sentence."""
    certain, rest = len(report.certain), len(report.faults) - len(report.certain)
    if not report.faults:
        return CLEAN
    counted = [f"{certain} certain"] if certain else []
    counted += [f"{rest} suspected"] if rest else []
    many = "s" if len(report.faults) > 1 else ""
    ends = "unusable as they are" if certain else "usable, with care"
    return f"The logs are {ends}: {' and '.join(counted)} fault{many}."


def enough(report: CheckReport | None) -> list[str]:
    """Return what the motion is too poor for, and the motion that would help."""
    if report is None:
        return []
    out = []
    for kind, help in _MORE.items():
        found = [fault for fault in report.faults if fault.kind == kind]
        joints = sorted({joint for fault in found for joint in fault.joints})
        if found:
            where = f" ({joint_words(joints)})" if joints else ""
            meaning = MEANING[kind]
            out.append(f"These logs can show little: {meaning}{where}. {help}")
    return out[:1]


def title(fault: FaultReport) -> str:
    """Return what is wrong and where: 'torque counts the other way round, joint 2'."""
    joints = joint_words(fault.joints)
    meaning = MEANING.get(fault.kind, fault.kind.replace("_", " "))
    return f"{meaning} ({joints})" if joints else meaning

"""Made-up outcomes for the report's tests: plausible numbers, every kind of verdict."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from residual.model.compare import FindingScatter, LogPrediction
from residual.verdict.result import Diagnosis
from tests.verdict_documents import typed, whole_document

DOF = 6
DRIFT = {"on": "t", "of": [], "form": "curve", "share": 0.6, "frequency": None}
NOTES = (
    "fit: A B | baseline: – | held out: C",
    "kinematics low-passed at 12 Hz, torque at 8 Hz, zero phase",
)


def effect(name: str, joints: list[int], parameters: dict, **more: object) -> dict:
    evidence = {
        "nats": more.pop("nats", 360.0),
        "by": more.pop("by", "fit"),
        "held_out": more.pop("held_out", "confirmed"),
        "held_out_gain": 0.31,
    }
    base = {"name": name, "joints": joints, "probability": 0.97, "order": 1}
    base |= {"equivalent": [], "parameters": parameters, "evidence": evidence}
    return base | more


def parameter(value: object, std: object, unit: str) -> dict:
    return {"value": value, "std": std, "unit": unit}


KEYS = {"viscous": "coefficient", "coulomb": "level", "rotor_inertia": "inertia"}


def given_value(
    name: str, joint: int, nominal: float = 4.0, identified: float = 4.6, **more: object
) -> dict:
    about = {"parameter": KEYS.get(name, "m3 + m4"), "unit": "N m", "std": 0.1}
    about |= {"sigma": 6.0, "beyond": True, "explained": False} | more
    numbers = {"nominal": nominal, "identified": identified}
    return {"name": name, "joints": [joint], **numbers, **about}


BALANCER = effect(
    "balancer",
    [2],
    {"sin": parameter(-719.4, 88.1, "N m"), "cos": parameter(6983.2, 41.7, "N m")},
    equivalent=[{"name": "spring", "joints": [2]}],
)
COULOMB_ALL = effect(
    "coulomb",
    [1, 2, 3, 4, 5, 6],
    {
        "level": parameter(
            [412.0, 388.1, 296.4, 41.22, 38.05, 22.9], [9.1, 12.0, 7.7, 0.61, 0.55, 0.32], "N m"
        )
    },
    nats=4120.0,
    probability=0.9999,
)
OFFSET = effect(
    "offset",
    [4],
    {"torque": parameter(0.741, 0.022, "N m")},
    equivalent=[{"name": "coulomb_asymmetry", "joints": [4]}],
    nats=88.0,
    probability=0.91,
    order=3,
)
RIPPLE = effect(
    "ripple",
    [5],
    {
        "amplitude": parameter(3.1, 0.2, "N m"),
        "order": parameter(27.06, 0.04, "1"),
        "phase": parameter(-1.2, 0.1, "rad"),
    },
    nats=41.0,
    by="plausibility",
    held_out="neutral",
    probability=0.83,
    order=4,
)
BEFORE = {
    "nominal": [61.2, 74.0, 55.1, 83.4, 77.8, 402.0],
    "identified": [4.2, 22.7, 4.3, 11.3, 6.0, 7.0],
    "augmented": [4.2, 4.7, 2.7, 11.4, 6.0, 7.0],
    "plsr": None,
}
FILTERED = {
    "nominal": [60.8, 71.9, 55.0, 83.0, 77.2, 396.0],
    "identified": [4.9, 22.4, 4.8, 12.2, 6.6, 7.7],
    "augmented": [4.9, 14.8, 3.3, 12.3, 6.6, 7.7],
    "plsr": None,
}


def verdict(kind: str, effects: list[dict], **changes: object) -> dict:
    without = {k: v for k, v in FILTERED.items() if k != "augmented"}
    same = without | {"augmented": FILTERED["identified"]}
    filtered = FILTERED if effects else same
    moving = BEFORE if effects else BEFORE | {"augmented": BEFORE["identified"]}
    raw = {k: v and [x + 3.1 for x in v] for k, v in filtered.items()}
    after = 7.9 if effects else 12.4
    overall = {"nominal": 66.3, "identified": 12.4, "augmented": after, "plsr": None}
    error = {
        "filter": {"cutoff_hz": 8.0},
        "logs": ["C"],
        "held_out": raw,
        "filtered": filtered,
        "moving": moving,
        "overall": {k: v and v + 3.0 for k, v in overall.items()},
        "overall_filtered": overall,
        "overall_moving": overall,
    }
    left = {"fraction": 0.04, "noise_floor": 0.011, "noise_model": "autocorrelation"}
    part = {
        "robot": "kr300",
        "declared": ["viscous", "coulomb", "rotor_inertia"],
        "verdict": kind,
        "effects": effects,
        "unexplained": left | {"per_joint": [0.03, 0.02, 0.02, 0.04, 0.03, 0.03]},
        "error": error | changes,
        "nominal_scale": 0.3,
    }
    return whole_document(part, DOF)


def bare_diagnosis(result: dict, sentences: tuple, proofs: tuple, clouds: tuple) -> Diagnosis:
    verdict = typed(result, DOF)
    return Diagnosis(verdict, {}, proofs, clouds, NOTES, sentences=sentences)


def proof(rng: np.random.Generator, label: str = "C", n: int = 2000) -> LogPrediction:
    """Return a held-out log of 16 s with the joint 2 effect in it."""
    t, phase = np.linspace(0, 16.5, n), np.arange(DOF) + 1.0
    q = 0.6 * np.sin(0.9 * t[:, None] * (1 + 0.15 * phase) + phase)
    qd = np.gradient(q, t, axis=0)
    size = np.array([900.0, 6000, 2500, 220, 180, 60])
    clean = size * (np.cos(q) + 0.25 * np.tanh(qd / 0.02))
    tau = clean + 0.03 * size * rng.normal(size=(n, DOF))
    missing = np.zeros_like(tau)
    missing[:, 1] = 1500 * np.cos(q[:, 1] * 2)
    hats = {"nominal": clean * 0.4, "identified": clean - missing, "augmented": clean}
    return LogPrediction(label, t, tau, hats, np.abs(qd) > 0.05)


def cloud(
    rng: np.random.Generator,
    name: str,
    joint: int,
    shape: Callable[[np.ndarray], np.ndarray],
    span: tuple[float, float] = (-1.5, 1.5),
) -> FindingScatter:
    """Return the cloud of a finding whose effect has this shape over its variable."""
    x = rng.uniform(*span, 3000)
    fitted = shape(x)
    residual = fitted + rng.normal(0, 0.25 * np.ptp(fitted), 3000)
    log = np.where(np.arange(3000) < 1600, "A", "B")
    axis = "q" if name in ("balancer", "spring", "ripple") else "qd"
    unit = "rad" if axis == "q" else "rad/s"
    return FindingScatter(name, joint, f"{axis}{joint} [{unit}]", x, residual, fitted, log)


def balancer_shape(x: np.ndarray) -> np.ndarray:
    """Torque of a balancer [N m]."""
    return -719 * np.sin(x) + 6983 * np.cos(x)


def one_effect() -> Diagnosis:
    rng = np.random.default_rng(1)
    result = verdict("effects", [BALANCER])
    result["unexplained"] |= {
        "joints": [1, 4, 6],
        "kind": "repeatable",
        "per_joint": [0.07, 0.02, 0.02, 0.12, 0.03, 0.08],
    }
    result["warnings"] = ["base_tilt was refuted on log C and is not reported."]
    clouds = (cloud(rng, "balancer", 2, balancer_shape, (-0.9, 0.2)),)
    sentence = "A balancer carries part of the weight: torque follows sin q2 and cos q2"
    return bare_diagnosis(result, (f"{sentence}.",), (proof(rng),), clouds)


def several() -> Diagnosis:
    rng = np.random.default_rng(2)
    effects = [COULOMB_ALL, BALANCER | {"order": 2}, OFFSET, RIPPLE]
    result = verdict("effects", effects)
    result["declared"] = []
    result["minimum_detectable"] = detectable()
    result["next_experiment"] = {
        "rivals": [{"name": "offset", "joints": [4]}, {"name": "balancer", "joints": [4]}],
        "family": "cyclic",
        "parameters": {"periods": 2, "seed": 3},
        "seconds": 20.0,
        "expected_nats": 14.2,
        "chance": 0.93,
        "program": None,
    }
    levels = COULOMB_ALL["parameters"]["level"]["value"]
    clouds = [
        cloud(rng, "coulomb", j + 1, lambda x, a=a: a * np.sign(x)) for j, a in enumerate(levels)
    ]
    clouds += [
        cloud(rng, "balancer", 2, balancer_shape, (-0.9, 0.2)),
        cloud(rng, "offset", 4, lambda x: 0.74 + 0 * x),
        cloud(rng, "ripple", 5, lambda x: 3.1 * np.cos(27 * x - 1.2)),
    ]
    sentences = tuple(f"Sentence about {e['name']}." for e in effects)
    proofs = (proof(rng), proof(rng, "D"))
    return bare_diagnosis(result, sentences, proofs, tuple(clouds))


def detectable() -> list[dict]:
    sizes = [("payload", [6], 0.2, "kg"), ("base_tilt", [], 0.004, "rad")]
    sizes += [("stribeck", [j], 0.4 * j, "N m") for j in range(1, DOF + 1)]
    sizes += [("spring", [j], 14.2 / j, "N m/rad") for j in range(1, DOF + 1)]
    keys = ("name", "joints", "value", "unit")
    return [dict(zip(keys, size, strict=True), confusable=[]) for size in sizes]


def nothing() -> Diagnosis:
    result = verdict("none", [])
    result["minimum_detectable"] = detectable()
    return bare_diagnosis(result, (), (proof(np.random.default_rng(3)),), ())


def unknown() -> Diagnosis:
    result = verdict("unknown", [])
    result["unexplained"] |= {
        "joints": [1, 4],
        "kind": "time-driven",
        "depends_on": [DRIFT | {"joint": j} for j in (1, 4)],
        "per_joint": [0.13, 0.02, 0.02, 0.21, 0.03, 0.03],
    }
    result["warnings"] = ["delay is withdrawn: it explains 41 % of joint 4 only."]
    return bare_diagnosis(result, (), (proof(np.random.default_rng(4)),), ())


def same_run() -> Diagnosis:
    out = one_effect()
    error = replace(out.errors, same_run=True, logs=("run.csv@75%:",))
    warning = "Held-out motion is the last quarter of the same log."
    return replace(out, verdict=replace(out.verdict, error=error, warnings=(warning,)))


_MAKERS = (one_effect, several, nothing, unknown, same_run)
ALL = {maker.__name__: maker for maker in _MAKERS}

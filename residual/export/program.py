"""A model as a list of things to compute, for writers of programs in any language."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources

import numpy as np

from residual.effects.base import BRISTLE, Portable, Trait
from residual.export.exported import Split, Whole, body_of, file_stem, split
from residual.model.corrected import DIFFERENCE, NONE, Corrected, Tables
from residual.model.model import LEAST_SPEED, Model, Term
from residual.recording import Array
from residual.robot.dynamics import Chain, chain_of
from residual.signals.standstill import SMOOTH, Standstill

WORD = re.compile(r"[a-z]\w*")


@dataclass(frozen=True, eq=False, slots=True)
class Line:
    """One formula of one term, on one joint.

    Attributes:
        title: What it is.
        row: Joint whose torque it adds to, from 0.
        joints: Joints that it reads, from 0; one, or the two of a pair.
        formula: The expression (``effects.base.Portable``).
        theta, shape: Its coefficients and the numbers of its shape.
        memory: Where its memory begins among all numbers that are kept.
        of_report: It distorts the report of the torque.
    """

    title: str
    row: int
    joints: tuple[int, ...]
    formula: str
    theta: Array
    shape: tuple[float, ...]
    memory: int = 0
    of_report: bool = False

    @property
    def words(self) -> set[str]:
        """Names that the formula uses."""
        return set(WORD.findall(self.formula))


@dataclass(frozen=True, eq=False, slots=True)
class Shift:
    """An encoder that lies: three formulas for what it is off by, and its rates."""

    title: str
    joint: int
    formulas: tuple[str, str, str]
    theta: Array


@dataclass(frozen=True, eq=False, slots=True)
class Program:
    """What is to be computed for one model.

    Attributes:
        name: Name of the robot.
        chain: Its kinematics.
        gravity: Gravity in the base frame [m/s^2]. Shape (3,).
        rigid: Inertial parameters of the rigid body [SI]. Shape (dof, 10).
        added: Those that terms add, None for none. Shape (dof, 10).
        loaded: Those of the body that encoders and gravity act on. Shape (dof, 10).
        tilt: What is added to gravity, None for nothing [m/s^2]. Shape (3,).
        force: Force on the flange, None for none [N]. Shape (3,).
        drive: Torque of the drives per speed and per acceleration. Shape (2, dof).
        floor: Speeds under which a joint stands [rad/s]. Shape (dof,).
        standstill: Behaviour of each joint there.
        bristles: Where the memory of a joint at standstill begins, -1 for none.
        others: Titles of the terms that bodies, gravity and force stand for.
        lines, shifts: What the other terms add.
        memory: Numbers to be kept from sample to sample.
        tables: Tables on top of it.
    """

    name: str
    chain: Chain
    gravity: Array
    rigid: Array
    added: Array | None
    loaded: Array
    tilt: Array | None
    force: Array | None
    drive: Array
    floor: Array
    standstill: tuple[Standstill, ...]
    bristles: tuple[int, ...]
    others: tuple[str, ...]
    lines: tuple[Line, ...]
    shifts: tuple[Shift, ...]
    memory: int
    tables: tuple[Tables, ...]

    @property
    def dof(self) -> int:
        """Number of joints."""
        return len(self.floor)

    @property
    def titles(self) -> list[str]:
        """What it has, in words."""
        titles = dict.fromkeys(x.title for x in (*self.lines, *self.shifts))
        tables = [f"tables on joint {x.joint + 1}" for x in self.tables]
        return ["the rigid body", *self.others, *titles, *tables]


def split_program(whole: Whole) -> Split:
    """Part what a program can compute, sample by sample, from the rest."""

    def refuse(term: Term) -> str:
        said = term.effect.portable
        if _is_said(said) and said.possible(term.theta, term.shape):
            return ""
        return said.why_not or "no formula says it"

    return split(whole, refuse)


def _is_said(said: Portable) -> bool:
    return any((said.formula, said.shift, said.bodies, said.gravity, said.force))


def program_of(carried: Whole) -> Program:
    """Return what is to be computed for a model all of which can be said."""
    model = body_of(carried)
    robot, dof = model.robot, model.robot.dof
    standstill = model.standstill or (SMOOTH,) * dof
    bristles, memory = [], 0
    for shape in standstill:
        kept = shape.kind == "bristle" and shape.size > 0
        bristles.append(memory if kept else -1)
        memory += BRISTLE if kept else 0
    lines, memory = _lines(model, memory)
    known = model.speed_floor
    state = model.state(1.0, np.zeros(1), np.zeros((3, 1, dof)))
    tables = carried.tables if isinstance(carried, Corrected) else ()
    return Program(
        name=file_stem(carried),
        chain=chain_of(robot.model),
        gravity=np.array(robot.model.gravity.linear),
        rigid=model.inertial.reshape(dof, 10),
        added=_sum(model, "bodies"),
        loaded=np.asarray(state.inertial).reshape(dof, 10),
        tilt=_sum(model, "gravity"),
        force=_sum(model, "force"),
        drive=np.asarray(state.drive),
        floor=np.full(dof, LEAST_SPEED) if known is None else known,
        standstill=tuple(standstill),
        bristles=tuple(bristles),
        others=tuple(
            _title(t)
            for t in model.terms
            if not (t.effect.portable.formula or t.effect.portable.shift)
        ),
        lines=tuple(lines),
        shifts=tuple(_shifts(model)),
        memory=memory,
        tables=tuple(t for t in tables if t.kind != NONE),
    )


def _lines(model: Model, memory: int) -> tuple[list[Line], int]:
    out = []
    for term in model.terms:
        effect, said = term.effect, term.effect.portable
        rows = effect.rows(term.joints, model.robot.dof) if said.formula else ()
        for k, row in enumerate(rows):
            text = said.formula[k if len(said.formula) > 1 else 0]
            joints = term.joints if effect.scope == "pair" else (row,)
            numbers = (term.theta, term.shape, memory, Trait.REPORT in effect.traits)
            out.append(Line(_title(term), row, joints, text, *numbers))
            memory += said.memory
    return out, memory


def _shifts(model: Model) -> Sequence[Shift]:
    return [
        Shift(_title(term), term.joints[0], said, term.theta)
        for term in model.terms
        if (said := term.effect.portable.shift)
    ]


def _title(term: Term) -> str:
    on = " and ".join(str(j + 1) for j in term.joints)
    return f"{term.effect.name} on joint {on}" if on else term.effect.name


def _sum(model: Model, what: str) -> Array | None:
    """All bodies, pushes of gravity, or forces that the terms add; None for none."""
    parts = []
    for term in model.terms:
        add = getattr(term.effect.portable, what)
        if add and what == "bodies":
            parts.append(add(term.theta, term.joints, model.robot).reshape(-1, 10))
        elif add:
            given = (term.theta,) if what == "force" else (term.theta, model.robot)
            parts.append(add(*given))
    return sum(parts) if parts else None


def arrays_of(program: Program) -> dict[str, Array]:
    """Return the numbers by name.

    The rotation of a joint is R(q) = still + cos(q) along + sin(q) across.
    """
    chain = program.chain
    turns = ~chain.slides[:, None, None]
    onto = np.where(turns, np.einsum("ij,ik->ijk", chain.axis, chain.axis), np.eye(3))
    skew = np.cross(np.eye(3)[None], chain.axis[:, None, :]) * turns
    arrays: dict[str, Array | None] = {
        "place": chain.place,
        "axis": chain.axis * turns[:, 0],
        "slide": chain.axis * chain.slides[:, None],
        "still": chain.rotation @ onto,
        "along": chain.rotation @ (np.eye(3) - onto),
        "across": chain.rotation @ skew,
        "flange": chain.flange,
        "gravity": program.gravity,
        "rigid": program.rigid,
        "added": program.added,
        "tilt": program.tilt,
        "force": program.force,
    }
    if program.shifts or program.tilt is not None:
        arrays["loaded"] = program.loaded
    if program.shifts:
        arrays["drive"] = program.drive
    return {name: values for name, values in arrays.items() if values is not None}


def reads_of(tables: Tables, arrays: Mapping[str, str], load: str) -> list[str]:
    """Return what the tables of a joint read, as expressions; the load is the last.

    Given what the program calls the columns of a table, and the torque of all joints.
    """
    reads = []
    for on, of, form in tables.columns:
        sign = " - " if form == DIFFERENCE else " + "
        reads.append(sign.join(f"{arrays[on]}[{j}]" for j in of))
    return [*reads, f"{load}[{tables.joint}]"][: len(tables.lookup.names)]


def filled(text: str, words: Mapping[str, str]) -> str:
    """Return a text with @NAME@ replaced by what it stands for."""
    for name, word in words.items():
        text = text.replace(f"@{name}@", word)
    return text


def template(name: str) -> str:
    """Return a text of the folder `templates`."""
    folder = resources.files("residual") / "export" / "templates"
    return folder.joinpath(name).read_text(encoding="utf-8")

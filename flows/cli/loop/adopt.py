"""modelgap models, adopt and rollback: which model a robot has, since when and why."""

from rich.console import Console

from flows.cli.options import Flag
from flows.outputs import say
from flows.report.console import show
from flows.report.models import ADOPTED_KEY, adoption_lines, adoptions
from flows.settings import store_folder
from flows.steps.loop.adopt import Adopt, list_adoptions, roll_back
from flows.steps.loop.adopt import adopt as give
from warehouse.objects.mirror import shown


def models(*, robot: str | None = None, store: str | None = None) -> None:
    """List which model each robot has, since when and why.

    ```
    modelgap models
    modelgap models --robot irb140
    ```

    The last line of a robot is the model that commands on this store go by; the lines
    above are what it had before. `modelgap sql 'SELECT * FROM adopted'` has it too.

    Args:
        robot: List one robot alone: its name, or what --robot takes elsewhere.
        store: Folder of the store; else $MODELGAP_STORE, else ./store.
    """
    console, listed = Console(), list_adoptions(store, robot)
    if not listed:
        whose = f"{robot} has" if robot else "Every robot has"
        say(console, f"{whose} its nominal model in {shown(store_folder(store))}.")
        return
    show(console, adoptions(listed), ADOPTED_KEY)


def adopt(
    id: str,
    /,
    *,
    note: str = "",
    force: Flag = False,
    store: str | None = None,
) -> None:
    """Let the augmented model of a diagnosis be the model of its robot from now on.

    ```
    modelgap adopt 77e0 --note "gripper changed on Monday"
    ```

    The whole of it: inertias, friction, effects that were named, tables. Commands on
    this store then go by it and say so. Held-out motion must bear it out: a lower
    error, on no joint a higher one, and each new effect of the size that the model
    gives it. A refusal says what is missing.

    Args:
        id: Id of a diagnosis, or of the model that it ended with.
        note: A word about it, which is kept.
        force: Adopt it against the gate; that needs a --note.
        store: Folder of the store; else $MODELGAP_STORE, else ./store.
    """
    number, judged = give(Adopt(id, note, force, store))
    say(Console(), *adoption_lines(number, judged))


def rollback(
    *, robot: str | None = None, note: str = "", store: str | None = None
) -> None:
    """Give a robot the model back that it had before; nothing is deleted.

    ```
    modelgap rollback --robot irb140 --note "alarm on joint 2 all night"
    ```

    Args:
        robot: The robot; not needed where only one has an adopted model.
        note: A word about it, which is kept.
        store: Folder of the store; else $MODELGAP_STORE, else ./store.
    """
    number, made = roll_back(robot, note, store)
    now = "its nominal model"
    if made.diagnosis_id is not None:
        now = f"the model of diagnosis {made.diagnosis_id[:8]}"
    say(Console(), f"adoption {int(number)}: {made.robot} has {now} again")

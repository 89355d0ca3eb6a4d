"""What `up` puts on a server: deployments, automations, notifications, a history."""

import json
import re
import sqlite3
from contextlib import contextmanager
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread

import pytest

from flows.project import NotifyTable, Project, ProjectTable, RobotTable
from residual.errors import InputError
from tests.waiting import until

pytestmark = pytest.mark.prefect
ARM = RobotTable("cell", "irb140", simulated=True)
WEBHOOK = "LAB_WEBHOOK"


@pytest.fixture
def up(server):
    """Put a project on the server of the tests, as `modelgap up` does."""
    from flows.service.api import Api, create_work_pool
    from flows.service.up import deploy

    @contextmanager
    def client(project):
        with Api(server.url, server.key).client() as client:
            create_work_pool(client, 1)
            deploy(client, project, server.key)
            yield client

    return client


@pytest.fixture
def chat(monkeypatch):
    """A web server that keeps what is sent to it; its address is in the environment."""
    heard = []

    class Chat(BaseHTTPRequestHandler):
        def do_POST(self):
            size = int(self.headers["Content-Length"])
            heard.append((self.path, json.loads(self.rfile.read(size))))
            self.send_response(204)
            self.end_headers()

        def log_message(self, *_):
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Chat) as web:
        Thread(target=web.serve_forever, daemon=True).start()
        address = f"http://127.0.0.1:{web.server_port}"
        monkeypatch.setenv(WEBHOOK, f"{address}/secret")
        yield heard, address
        web.shutdown()


def project(folder, robots=(ARM,), **notify) -> Project:
    table = NotifyTable(**notify) if notify else None
    return Project(folder, ProjectTable(1, robot=robots, notify=table))


def test_people_are_notified_and_what_is_not_wanted_any_more_goes(up, chat, tmp_path):
    from prefect.blocks.notifications import CustomWebhookNotificationBlock

    from flows.pipelines.tasks import send_notice

    heard, address = chat
    form = {"title": "{{subject}}", "text": "{{body}}"}
    url = f"{address}/block"
    block = CustomWebhookNotificationBlock(name="lab", url=url, json_data=form)
    block.save("lab", overwrite=True)
    kinds = ("alarm", "refused")
    asked = {"block": "custom-webhook/lab", "webhook": WEBHOOK, "kinds": kinds}
    both = project(tmp_path, (ARM, replace(ARM, name="trial", nightly="")), **asked)
    with up(both) as client:
        first = {each.name: each for each in client.read_deployments()}
        send_notice("finding", "irb140", "was not asked for")
        send_notice("alarm", "irb140", 'a "spike" on joint 2', "by 5 N m", ["ab"], "p")
        until(lambda: len(heard) == 2, "both have it")
    message = dict(heard)
    assert message["/secret"] == {
        "kind": "alarm",
        "robot": "irb140",
        "title": 'a "spike" on joint 2',
        "text": 'a "spike" on joint 2\nby 5 N m\np',
        "ids": ["ab"],
        "page": "p",
    }
    assert message["/block"] == {"title": 'a "spike" on joint 2', "text": "by 5 N m\np"}
    cell = first["cell"]
    assert {"cell", "trial", "monitor"} <= set(first)
    assert [s.schedule.cron for s in cell.schedules] == ["0 2 * * *"]
    assert cell.parameter_openapi_schema["properties"]["seed"]["title"] == "seed"
    assert cell.concurrency_options.collision_strategy.value == "CANCEL_NEW"
    with up(project(tmp_path)) as client:
        second = {each.name: each for each in client.read_deployments()}
        rules = [rule.name for rule in client.read_automations()]
    assert set(first) - set(second) == {"trial"}
    assert second["cell"].id == cell.id  # so its history stays
    assert len(set(rules)) == len(rules)  # nothing starts twice
    assert not [name for name in rules if name.startswith("notify")]


@pytest.mark.parametrize(
    ("notify", "words"),
    [
        ({"webhook": "NOT_SET"}, "NOT_SET has no value"),
        ({"webhook": "HOME"}, "HOME has another value"),
        ({"block": "slack-webhook/none"}, "has no 'slack-webhook/none'"),
    ],
)
def test_nobody_is_left_without_notice_in_silence(up, tmp_path, notify, words):
    with pytest.raises(InputError, match=words), up(project(tmp_path, **notify)):
        pass


@pytest.mark.parametrize("notify", [{}, {"block": "lab"}, {"webhook": "http://a/b"}])
def test_a_notification_names_whom(notify):
    with pytest.raises(ValueError, match=r"notifies nobody|pattern"):
        NotifyTable(**notify)


def test_a_new_history_is_as_the_last_migration_of_prefect_leaves_it(server, tmp_path):
    """What it holds is what the server of these tests has started with."""
    import prefect

    from flows.service.up import create_history

    create_history(tmp_path)
    with sqlite3.connect(tmp_path / "prefect.db") as history:
        ((ours,),) = history.execute("SELECT version_num FROM alembic_version")
    folder = Path(prefect.__file__).parent / "server/database/_migrations/versions"
    text = "".join(p.read_text("utf-8") for p in folder.glob("sqlite/*.py"))
    made, replaced = (
        set(re.findall(rf'^{word} = "(\w+)"', text, re.M)) for word in ("revision", "down_revision")
    )
    assert made - replaced == {ours}

"""Every page of a served store in a real browser: what it opens, says and asks for."""

import json
from types import SimpleNamespace

import pytest

from flows.report.store_index import write_index
from flows.service.state import read_access_key
from flows.settings import prefect_home
from tests.flows.browser import alone
from tests.flows.index.stores import fill
from tests.flows.prefect_server import served as serving

pytestmark = [pytest.mark.prefect, pytest.mark.slow, pytest.mark.long]

# A page that a stranger has put into a store; what it tries must come to nothing.
THIEF = b"""<!doctype html><title>stored</title><h1>Stored</h1><p id="told"></p>
<script>
const told = {};
try { told.key = localStorage.getItem("prefect-password"); }
catch (error) { told.key = "refused"; }
fetch("/api/flows/filter", {method: "POST", body: "{}",
  headers: {"Content-Type": "application/json"}})
  .then((answer) => { told.asked = answer.status; })
  .catch(() => { told.asked = "refused"; })
  .finally(() => { document.title = JSON.stringify(told); });
</script>"""
LINKS = """[...document.querySelectorAll("a[href]")].map((a) => a.href)
  .filter((link) => link.includes("/pages/")).map((link) => link.split(/[?#]/)[0])"""


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    nights = fill(tmp_path_factory.mktemp("seen") / "store", THIEF)
    home = prefect_home(nights.store)
    with serving(home) as running:
        yield SimpleNamespace(running=running, key=read_access_key(home), nights=nights)


@pytest.fixture
def tab(tmp_path):
    with alone(tmp_path, ", EXCLUDE 127.0.0.1") as tab:
        yield tab


def opened(tab, address: str) -> None:
    tab.open(address)
    ready = f"location.href === '{address}' && document.readyState"
    tab.wait(f"({ready}) === 'complete'", f"{address} is open")


def test_a_browser_without_the_key_sees_nothing(served, tab):
    tab.open(f"{served.running.pages}/index.html")
    tab.listen(2)
    assert "two_link" not in tab.run("document.documentElement.outerHTML")


def test_every_link_opens_at_both_widths_and_nothing_goes_beyond(served, tab):
    tab.log_in(served.running.ui, served.key)
    tab.open("about:blank")
    tab.wait("location.href === 'about:blank'", "it is left")
    tab.said.clear()
    tab.asked.clear()
    todo, seen = [f"{served.running.pages}/index.html"], {}
    while todo:
        address = todo.pop()
        if address in seen:
            continue
        for width in (1280, 390):
            tab.resize(width, 900)
            opened(tab, address)
            room = "document.documentElement.scrollWidth <= innerWidth"
            assert tab.run(room), (address, width)
        status = "performance.getEntriesByType('navigation')[0].responseStatus"
        seen[address] = tab.run(status)
        if address.endswith("/index.html"):
            todo += tab.run(LINKS)
    kinds = {address.removeprefix(served.running.pages) for address in seen}
    assert kinds == {
        "/index.html",
        f"/report_id={served.nights.report}/report.html",
        f"/report_id={served.nights.proposal}/proposal.html",
    }
    assert set(seen.values()) == {200}
    hosts = {url.split("/")[2] for url in tab.asked.values() if "://" in url}
    assert hosts == {f"127.0.0.1:{served.running.port}"}
    # The one thing that is said is what was refused to the page of the stranger.
    ours = [x for x in tab.said if "sandbox" not in x and "connect" not in x]
    assert ours == []


@pytest.mark.parametrize("width", [1280, 390])
def test_a_reader_narrows_the_index_and_the_address_keeps_it(tmp_path, tab, width):
    file = write_index(fill(tmp_path / "store").store).as_uri()
    tab.resize(width, 900)
    shown = "[...document.querySelectorAll('tbody tr')].filter((r) => r.clientHeight)"
    for address in (f"{file}#State=alarm", f"{file}#Words=gain+drop"):
        tab.open("about:blank")
        tab.wait("location.href === 'about:blank'", "it is left")
        tab.open(address)
        tab.wait("document.querySelector('.filters') !== null", "it is open")
        assert tab.run(f"{shown}.length") == 1
        assert "gain drop" in tab.run(f"{shown}[0].innerText")
        assert tab.run("location.href") == address
    tab.run("""for (const each of document.querySelectorAll('.filters *')) {
      each.value = ''; each.dispatchEvent(new Event('input')); }""")
    assert tab.run(f"{shown}.length") == 6


def test_a_stored_page_has_neither_the_key_nor_the_ear_of_the_server(served, tab):
    tab.log_in(served.running.ui, served.key)
    opened(tab, f"{served.running.pages}/report_id={served.nights.report}/report.html")
    doc = json.loads(tab.wait("document.title[0] === '{' && document.title", "tried"))
    assert doc == {"key": "refused", "asked": "refused"}

"""A bundle: the same records elsewhere; a hostile one adds nothing."""

import gzip
import hashlib
import io
import json
import os
import tarfile

import pyarrow as pa
import pytest

from residual.errors import InputError
from tests.warehouse import store_samples as made
from warehouse.bundle import CONTENTS, kind_of, read_bundle, write_bundle
from warehouse.files import read_parquet, write_parquet
from warehouse.layout import find, read_record
from warehouse.query.store import open_store
from warehouse.runs import open_seal, read_run


@pytest.fixture
def store(tmp_path):
    folder = tmp_path / "here"
    runs = [made.commit(folder, seed) for seed in range(3)]
    id = made.store_verdict(folder, made.verdict([runs[1]]), {"theta": [1]}, runs[:2])
    return folder, runs, id


@pytest.fixture
def bundle(store, tmp_path):
    write_bundle(store[0], store[2], tmp_path / "b.tar")
    return tmp_path / "b.tar"


def tree(folder):
    files = (p for p in folder.rglob("*") if p.is_file())
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in files}


def packed(path, members):
    """Write a tar of (name or TarInfo, content)."""
    with tarfile.open(path, "w") as tar:
        for name, content in members:
            member = (
                name if isinstance(name, tarfile.TarInfo) else tarfile.TarInfo(name)
            )
            if member.isreg():
                member.size = len(content)
            tar.addfile(member, io.BytesIO(content))
    return path


def unpacked(path):
    with tarfile.open(path) as tar:
        return {m.name: tar.extractfile(m).read() for m in tar}


def repacked(path, files, **more):
    """Write files with a list of contents that fits them."""
    contents = json.loads(files.pop(CONTENTS)) | more
    contents["files"] = {
        name: {"sha256": hashlib.sha256(data).hexdigest(), "bytes": len(data)}
        for name, data in files.items()
    }
    text = json.dumps(contents).encode()
    return packed(path, [(CONTENTS, text), *files.items()])


def assert_refused(path, tmp_path, match):
    there = tmp_path / "there"
    with pytest.raises(InputError, match=match):
        read_bundle(path, there)
    assert tree(there) == {}
    # Nor is anything beside it that a path with ".." would have made.
    names = {p.name for p in tmp_path.iterdir()}
    assert names <= {"here", "there", "b.tar", path.name}


def test_all_that_it_was_made_from_comes_along_and_nothing_else(
    store, bundle, tmp_path
):
    folder, runs, id = store
    there = tmp_path / "there"
    done = read_bundle(bundle, there)
    assert done.about == id
    here = tree(folder)
    same = {k: v for k, v in tree(there).items() if not k.startswith("_index")}
    assert same == {
        k: v for k, v in here.items() if not k.startswith("_index") and runs[2] not in k
    }
    assert read_record(there, id) == read_record(folder, id)
    assert open_seal(there, runs[0]).spec == made.sealed(0).spec
    with open_store(there) as opened:
        counted = opened.sql("SELECT count(*) AS n FROM runs").to_pylist()
        assert opened.damaged == ()
    assert counted == [{"n": 2}]


def test_a_bundle_is_the_same_bytes_each_time(store, bundle, tmp_path):
    again = tmp_path / "again.tar"
    write_bundle(store[0], store[2][:8], again)
    assert again.read_bytes() == bundle.read_bytes()


def test_what_is_there_is_left(store, bundle, tmp_path):
    there = tmp_path / "there"
    first = read_bundle(bundle, there)
    before = tree(there)
    again = read_bundle(bundle, there)
    assert (again.added, set(again.known)) == ((), set(first.added))
    assert tree(there) == before


def test_without_the_seal_it_is_added_later(store, bundle, tmp_path):
    folder, runs, id = store
    done = write_bundle(folder, id, tmp_path / "open.tar", with_seal=False)
    assert (done.seals, done.left_out) == (0, 2)
    there = tmp_path / "there"
    read_bundle(tmp_path / "open.tar", there)
    assert not (there / "sealed").exists()
    with pytest.raises(InputError, match="no sealed half"):
        open_seal(there, runs[0])
    assert len(read_bundle(bundle, there).added) == 2
    assert read_run(there, runs[0]).id == runs[0]
    assert open_seal(there, runs[0]).spec["salt"] == "s0"


def test_a_damaged_record_goes_into_no_bundle(store, tmp_path):
    folder, runs, id = store
    path = find(folder, runs[0]).folder / "part-0.parquet"
    path.write_bytes(path.read_bytes()[:-9])
    with pytest.raises(InputError, match="goes into no bundle"):
        write_bundle(folder, id, tmp_path / "b.tar")
    assert not (tmp_path / "b.tar").exists()


@pytest.mark.parametrize(
    "name",
    [
        "../outside.txt",
        "/etc/cron.d/x",
        "samples/robot=a/run_id=../../x/part-0.parquet",
        "samples/robot=a/run_id=00000000000000000000/../part-0.parquet",
        "samples/robot=A B/run_id=00000000000000000000/part-0.parquet",
        "samples/robot=a/run_id=00000000000000000000/part-1.parquet",
        "models/model_id=00000000000000000000/x.pkl",
        "models/model_id=00000000000000000000/.hidden.json",
        "_index/runs.parquet",
        "quarantine/run_id=00000000000000000000.json",
        "_prefect/prefect.db",
        "made_with/changes-x.patch.gz",
        "sealed/run_id=00000000000000000000/spec.json\n",
        "samples\\x",
        "",
    ],
)
def test_only_paths_of_the_store_are_taken(bundle, tmp_path, name):
    assert kind_of(name) is None
    files = unpacked(bundle)
    path = repacked(tmp_path / "bad.tar", {**files, name or "a": b"x"})
    assert_refused(path, tmp_path, "is no path of a store's file")


@pytest.mark.parametrize(
    "type", [tarfile.SYMTYPE, tarfile.LNKTYPE, tarfile.DIRTYPE, tarfile.FIFOTYPE]
)
def test_links_and_folders_are_refused(bundle, tmp_path, type):
    files = unpacked(bundle)
    name = next(n for n in files if n.endswith("_run.parquet"))
    link = tarfile.TarInfo(name)
    link.type, link.linkname = type, "/etc/passwd"
    members = [(link if n == name else n, data) for n, data in files.items()]
    assert_refused(packed(tmp_path / "bad.tar", members), tmp_path, "not a plain file")


def test_neither_mode_nor_owner_of_a_stranger_arrives(bundle, tmp_path):
    members = []
    for name, data in unpacked(bundle).items():
        member = tarfile.TarInfo(name)
        member.mode, member.uid, member.gid = 0o6777, 12345, 12345
        members.append((member, data))
    there = tmp_path / "there"
    read_bundle(packed(tmp_path / "odd.tar", members), there)
    files = [p for p in there.rglob("*") if p.is_file()]
    assert files
    for path in files:
        told = path.stat()
        assert told.st_mode & 0o7022 == 0
        assert (told.st_uid, told.st_gid) == (os.getuid(), os.getgid())


def test_a_file_that_is_not_on_the_list_or_twice_is_refused(bundle, tmp_path):
    files = unpacked(bundle)
    extra = "models/model_id=00000000000000000000/_model.parquet"
    path = packed(tmp_path / "bad.tar", [*files.items(), (extra, b"x")])
    assert_refused(path, tmp_path, "own list")
    last = list(files.items())[-1]
    path = packed(tmp_path / "bad.tar", [*files.items(), last])
    assert_refused(path, tmp_path, "there twice")


def test_a_bundle_that_was_cut_off_or_is_none_is_refused(bundle, tmp_path):
    bad = tmp_path / "bad.tar"
    bad.write_bytes(bundle.read_bytes()[:30_000])
    assert_refused(bad, tmp_path, "no bundle|missing|hash")
    bad.write_bytes(b"hello" * 400)
    assert_refused(bad, tmp_path, "is no bundle")
    bad.write_bytes(gzip.compress(bundle.read_bytes()))
    assert_refused(bad, tmp_path, "is no bundle")
    packed(bad, [("other.txt", b"x")])
    assert_refused(bad, tmp_path, "first file is not")
    with pytest.raises(InputError, match="There is no file"):
        read_bundle(tmp_path / "none.tar", tmp_path / "there")


@pytest.mark.parametrize(
    "text",
    [
        b"[]",
        b"{",
        b'{"schema": 1}',
        b"[" * 200_000,
        b'{"schema":1,"about":[],"records":[],"files":{}}',
        b'{"schema":2,"about":"","records":[],"files":{}}',
    ],
)
def test_a_list_of_another_form_is_refused(tmp_path, text):
    path = packed(tmp_path / "bad.tar", [(CONTENTS, text)])
    assert_refused(path, tmp_path, "is no bundle")


def test_sizes_that_would_fill_a_disk_are_refused_unread(tmp_path):
    name = "models/model_id=00000000000000000000/_model.parquet"
    for size in (10**15, -1, 1.5, "9", None):
        contents = {"schema": 1, "about": "0" * 20, "records": []}
        contents["files"] = {name: {"sha256": "0", "bytes": size}}
        text = json.dumps(contents).encode()
        path = packed(tmp_path / "bad.tar", [(CONTENTS, text), (name, b"x")])
        assert_refused(path, tmp_path, "no usable size")


def changed(files, ending, change, tmp_path):
    """Return files with one Parquet file changed; its new hash is not hidden."""
    name = next(n for n in files if n.endswith(ending))
    path = tmp_path / "changed.parquet"
    path.write_bytes(files[name])
    table = read_parquet(path)
    write_parquet(path, change(table))
    content = path.read_bytes()
    path.unlink()
    return {**files, name: content}


def louder(table):
    at = table.column_names.index("tau1")
    values = table.column("tau1").to_numpy() * 2
    return table.set_column(at, table.schema.field(at), [values])


def other(column, before, after):
    def change(table):
        at = table.column_names.index(column)
        text = table.column(column)[0].as_py().replace(before, after)
        return table.set_column(at, column, [[text]])

    return change


def mistyped(table):
    at = table.column_names.index("created")
    return table.set_column(at, "created", [["yesterday"]])


def row(column, value):
    def change(table):
        at = table.column_names.index(column)
        field = table.schema.field(at)
        return table.set_column(at, field, pa.array([value], field.type))

    return change


CHANNELS = ["t", "q", "tau) FROM x --"]


@pytest.mark.parametrize(
    ("ending", "change", "match"),
    [
        ("_run.parquet", row("signals", CHANNELS), "names channels"),
        ("_run.parquet", row("dof", 1_000_000), "other numbers"),
        ("_run.parquet", row("robot", "other"), "another robot"),
        ("_run.parquet", row("manifest", "[" * 100_000), "recursion depth"),
        ("part-0.parquet", louder, "not those that were committed"),
        (
            "_run.parquet",
            other("manifest", "fourier", "welding"),
            "spec is not the one",
        ),
        ("_diagnosis.parquet", other("record", "payload", "nothing"), "its id is"),
        ("_run.parquet", mistyped, "another form"),
        ("_run.parquet", row("created", None), "its created has no value"),
        ("_run.parquet", row("kind", None), "its kind has no value"),
        ("_run.parquet", row("trajectory", "\x1b[31mred"), "control character"),
        ("_run.parquet", row("tags", ["a", "\u202ega"]), "control character"),
        ("_diagnosis.parquet", row("created", None), "its created has no value"),
        ("_diagnosis.parquet", row("serial", "\x9b31m"), "control character"),
        (
            "_diagnosis.parquet",
            other("provenance", '": "', '": "\\u001b'),
            "control character",
        ),
        ("truth.parquet", lambda table: table.slice(1), "not the seal"),
    ],
)
def test_records_that_are_not_what_their_id_says_are_refused(
    bundle, tmp_path, ending, change, match
):
    bad = changed(unpacked(bundle), ending, change, tmp_path)
    assert_refused(repacked(tmp_path / "bad.tar", bad), tmp_path, match)


def test_a_seal_with_another_spec_is_refused(bundle, tmp_path):
    files = unpacked(bundle)
    name = next(n for n in files if n.endswith("spec.json"))
    bad = {**files, name: b'{"effects":["none"],"salt":"s0"}'}
    assert_refused(repacked(tmp_path / "bad.tar", bad), tmp_path, "not the seal")


def test_a_wrong_hash_is_refused(bundle, tmp_path):
    files = unpacked(bundle)
    name = next(n for n in files if n.endswith("packages-") or "packages-" in n)
    bad = {**files, name: files[name][:-1] + b"!"}
    assert_refused(
        packed(tmp_path / "bad.tar", bad.items()), tmp_path, "hash is another one"
    )
    assert_refused(repacked(tmp_path / "bad.tar", bad), tmp_path, "another hash")

"""What is taken for an address, where its keys come from, and what goes unencrypted."""

import os

import pytest

from flows.settings import resolve_store_folder
from residual.errors import InputError
from warehouse import bucket
from warehouse.bucket import is_bucket_address, parse_bucket_address
from warehouse.queries import open_store


@pytest.fixture(autouse=True)
def nothing_set(monkeypatch, tmp_path):
    for name in [name for name in os.environ if name.startswith("AWS_")]:
        monkeypatch.delenv(name)
    monkeypatch.setenv("AWS_EC2_METADATA_DISABLED", "true")
    monkeypatch.setenv("AWS_SHARED_CREDENTIALS_FILE", str(tmp_path / "credentials"))
    monkeypatch.setenv("AWS_CONFIG_FILE", str(tmp_path / "config"))


@pytest.mark.parametrize(
    ("word", "address"),
    [
        ("s3://robots", ("robots", "")),
        ("s3://robots/", ("robots", "")),
        ("s3://my.robots-1/cell/2", ("my.robots-1", "cell/2")),
    ],
)
def test_an_address_is_a_bucket_and_a_prefix(word, address):
    assert is_bucket_address(word)
    assert parse_bucket_address(word) == address


@pytest.mark.parametrize(
    "word",
    [
        "s3:/robots/a",
        "gs://robots/a",
        "http://127.0.0.1:9000/robots",
        "file:///tmp/store",
        "s3://",
        "s3:///a",
        "s3://UPPER/a",
        "s3://ab",
        "s3://robots/../other",
        "s3://robots//a",
        "s3://robots/a b",
        "s3://robots/a*",
        "s3://robots/a?x=1",
    ],
)
def test_any_other_scheme_is_refused_and_no_folder_is_made(word, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=r"xpected|may have"):
        resolve_store_folder(word)
    with pytest.raises(InputError):
        open_store(word)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("word", ["store", "./s3:/a", "a/b:/c", "/tmp/s3", "s3"])
def test_a_folder_is_a_folder(word):
    assert not is_bucket_address(word)


@pytest.mark.parametrize("host", ["127.0.0.1:9000", "localhost:9000", "[::1]:9000"])
def test_without_encryption_only_this_machine(host, monkeypatch):
    monkeypatch.setenv("AWS_ACCESS_KEY_ID", "a")
    monkeypatch.setenv("AWS_ENDPOINT_URL", f"http://{host}")
    assert bucket.read_bucket_settings()["client_options"] == {"allow_http": True}


def test_another_machine_without_encryption_must_be_said(monkeypatch):
    monkeypatch.setenv("AWS_ACCESS_KEY_ID", "a")
    monkeypatch.setenv("AWS_ENDPOINT_URL", "http://10.0.0.5:9000")
    with pytest.raises(InputError, match="AWS_ALLOW_HTTP=true"):
        bucket.read_bucket_settings()
    monkeypatch.setenv("AWS_ALLOW_HTTP", "true")
    assert bucket.read_bucket_settings()["endpoint"] == "http://10.0.0.5:9000"
    monkeypatch.setenv("AWS_ENDPOINT_URL", "ftp://10.0.0.5")
    with pytest.raises(InputError, match="expected https"):
        bucket.read_bucket_settings()


def test_a_profile_gives_keys_region_and_endpoint(tmp_path, monkeypatch):
    (tmp_path / "credentials").write_text(
        "[cell]\naws_access_key_id = mine\naws_secret_access_key = secret\n"
    )
    (tmp_path / "config").write_text(
        "[profile cell]\nregion = eu-1\nendpoint_url = http://127.0.0.1:9\n"
    )
    monkeypatch.setenv("AWS_PROFILE", "cell")
    settings = bucket.read_bucket_settings()
    keys = settings["credential_provider"]()
    assert (keys["access_key_id"], keys["secret_access_key"]) == ("mine", "secret")
    assert (settings["region"], settings["endpoint"]) == ("eu-1", "http://127.0.0.1:9")


def test_without_keys_it_says_which_are_missing():
    with pytest.raises(InputError, match="AWS_ACCESS_KEY_ID"):
        resolve_store_folder("s3://robots/a")

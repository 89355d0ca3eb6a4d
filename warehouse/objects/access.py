"""Endpoint and credentials of a bucket, from where every program looks for them.

The variables are those of the AWS tools: AWS_ENDPOINT_URL_S3 or AWS_ENDPOINT_URL,
AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY, AWS_SESSION_TOKEN, AWS_REGION or
AWS_DEFAULT_REGION; without keys in them the profile (AWS_PROFILE, ~/.aws) as botocore
reads it.
"""

import ipaddress
import os
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from urllib.parse import urlsplit

from residual.errors import InputError

_SCALE = "Object storage needs the extra: pip install '.[scale]' in the checkout."
# A profile may renew its keys; they are asked for again after this time.
_FRESH = timedelta(minutes=10)


def settings() -> dict:
    """Return what `obstore.store.S3Store` takes beside bucket and prefix.

    Raises:
        InputError: If there are no credentials, the extra is not installed, or the
            endpoint would be talked to in the open.
    """
    profile = None if os.environ.get("AWS_ACCESS_KEY_ID") else _Profile()
    endpoint = endpoint_url() or (profile and profile.endpoint)
    region = os.environ.get("AWS_REGION") or os.environ.get("AWS_DEFAULT_REGION")
    region = region or (profile and profile.region) or "us-east-1"
    asked: dict = {"region": region, **_endpoint(endpoint)}
    if profile:
        asked["credential_provider"] = profile.provider()
    return asked


def endpoint_url() -> str | None:
    """Return the endpoint that the variables name, None for that of AWS."""
    names = ("AWS_ENDPOINT_URL_S3", "AWS_ENDPOINT_URL", "AWS_ENDPOINT")
    return next((os.environ[name] for name in names if os.environ.get(name)), None)


def _endpoint(url: str | None) -> dict:
    if not url:
        return {}
    parts = urlsplit(url)
    if parts.scheme not in ("http", "https") or not parts.hostname:
        raise InputError(
            f"AWS_ENDPOINT_URL is '{url}', expected https://HOST or http://127.0.0.1:PORT."
        )
    if parts.scheme == "https":
        return {"endpoint": url}
    said = os.environ.get("AWS_ALLOW_HTTP", "").lower() in ("1", "true")
    if not said and not _is_loopback(parts.hostname):
        raise InputError(
            f"The endpoint {url} is not encrypted and on another machine: runs and "
            "keys would cross the network in the open. Use https, or say that it may "
            "be so: AWS_ALLOW_HTTP=true."
        )
    return {"endpoint": url, "client_options": {"allow_http": True}}


def _is_loopback(host: str) -> bool:
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


class _Profile:
    """Keys, region and endpoint of the user's profile.

    Raises:
        InputError: If there is none with keys.
    """

    def __init__(self) -> None:
        try:
            from botocore.exceptions import BotoCoreError
            from botocore.session import Session
        except ImportError as error:
            raise InputError(_SCALE) from error
        try:
            session = Session()
            self._found = session.get_credentials()
            self.region = session.get_config_variable("region")
            self.endpoint = session.get_scoped_config().get("endpoint_url")
        except BotoCoreError as error:
            raise InputError(f"The AWS profile is not usable: {error}") from error
        if self._found is None:
            raise InputError(
                "There are no keys for the object storage. Set AWS_ACCESS_KEY_ID and "
                "AWS_SECRET_ACCESS_KEY, or AWS_PROFILE."
            )

    def provider(self) -> Callable[[], dict]:
        """Return what gives the keys of the moment, as obstore asks for them."""

        def keys() -> dict:
            now = self._found.get_frozen_credentials()
            return {
                "access_key_id": now.access_key,
                "secret_access_key": now.secret_key,
                "token": now.token,
                "expires_at": datetime.now(UTC) + _FRESH,
            }

        return keys

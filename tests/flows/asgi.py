"""Requests and WebSockets played to an application, without a server."""

import asyncio
from base64 import b64encode

from flows.service.access_guard import build_access_rules

SECRET = "modelgap:a-key-of-thirty-two-letters-or-more"
OURS = build_access_rules("127.0.0.1", 4200, SECRET)
HOST, OWN = "127.0.0.1:4200", "http://127.0.0.1:4200"
JSON = ("content-type", "application/json")
BODY = ("content-length", "12")


def signed(secret: str = SECRET) -> tuple[str, str]:
    return "authorization", f"Basic {b64encode(secret.encode()).decode()}"


def scope(method="GET", path="/api/flows/", host=HOST, given=(), kind="http") -> dict:
    headers = [*([("host", host)] if host else []), *given]
    return {
        "type": kind,
        "method": method,
        "path": path,
        "headers": [(k.encode(), v.encode()) for k, v in headers],
        "query_string": b"",
    }


def origin(value: str) -> tuple[str, str]:
    return "origin", value


def answer(app, asked: dict, sent=()) -> list[dict]:
    given, answered = iter(sent), []

    async def receive():
        return next(given, {"type": "websocket.disconnect", "code": 1005})

    async def send(message):
        answered.append(message)

    asyncio.run(app(asked, receive, send))
    return answered


async def prefect(scope, receive, send):
    """What stands for Prefect: it tells what it was sent."""
    if scope["type"] == "websocket":
        await receive()
        await send({"type": "websocket.accept"})
        while (message := await receive())["type"] == "websocket.receive":
            await send({"type": "websocket.send", "text": message["text"]})
        return
    await send({"type": "http.response.start", "status": 200, "headers": []})
    await send({"type": "http.response.body", "body": b"reached"})

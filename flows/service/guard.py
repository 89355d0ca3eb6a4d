"""An application in front of Prefect's that lets through only what the rules allow."""

from dataclasses import dataclass

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import JSONResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from flows.service.pages.policies import KNOWN, STORED
from flows.service.rules import Rules, refusal

_POLICY_VIOLATION = 1008  # close code of a WebSocket, RFC 6455 section 7.4.1
# A page talks to its own server only. Prefect's pages set styles from scripts, and what
# draws their graphs compiles code of its own: allowed, since it too comes from here.
_PAGE = (
    "default-src 'self'; connect-src 'self' ws://{host}; "
    "script-src 'self' 'unsafe-eval'; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data: blob:; font-src 'self' data:; worker-src 'self' blob:; "
    "object-src 'none'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'"
)
_NOTHING = "default-src 'none'; frame-ancestors 'none'"
_POLICY, _OPENER = "Content-Security-Policy", "Cross-Origin-Opener-Policy"
_ALWAYS = {
    "X-Frame-Options": "DENY",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "same-origin",
    _OPENER: "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
}


@dataclass(frozen=True, slots=True)
class Guard:
    """An application that lets through only what the rules allow.

    Attributes:
        app: What is guarded.
        rules: Those of the server.
    """

    app: ASGIApp
    rules: Rules

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request or WebSocket, or the start of the server."""
        if scope["type"] == "http":
            await self._request(scope, receive, send)
        elif scope["type"] == "websocket":
            await self._websocket(scope, receive, send)
        else:
            await self.app(scope, receive, send)

    async def _request(self, scope: Scope, receive: Receive, send: Send) -> None:
        why = refusal(scope, self.rules)
        if why:
            answer = JSONResponse({"detail": why.words}, why.status)
            await answer(scope, receive, _with_headers(send, _NOTHING))
            return
        policy = _PAGE.format(host=Headers(scope=scope)["host"])
        await self.app(scope, receive, _with_headers(send, policy))

    async def _websocket(self, scope: Scope, receive: Receive, send: Send) -> None:
        if refusal(scope, self.rules):
            await receive()
            # Before it is accepted: the browser gets a 403.
            await send({"type": "websocket.close", "code": _POLICY_VIOLATION})
        elif self.rules.has_key(Headers(scope=scope)):
            await self.app(scope, receive, send)
        else:
            await self.app(scope, _key_first(receive, send, self.rules), send)


def _key_first(receive: Receive, send: Send, rules: Rules) -> Receive:
    """Let no message through before the one with the key, as Prefect's clients send it.

    For the application who does not send it has hung up.
    """
    shown = False

    async def checked() -> Message:
        nonlocal shown
        message = await receive()
        if message["type"] != "websocket.receive" or shown:
            return message
        shown = rules.is_key(message.get("text") or message.get("bytes") or "")
        if shown:
            return message
        await send({"type": "websocket.close", "code": _POLICY_VIOLATION})
        return {"type": "websocket.disconnect", "code": _POLICY_VIOLATION}

    return checked


def _with_headers(send: Send, policy: str) -> Send:
    async def sent(message: Message) -> None:
        if message["type"] == "http.response.start":
            headers = MutableHeaders(scope=message)
            own = headers.get(_POLICY, "")
            always = _ALWAYS | {_POLICY: own if own in KNOWN else policy}
            if own == STORED:  # browsers show no sandbox that asks for this as well
                del always[_OPENER]
            for name, value in always.items():
                headers[name] = value
        await send(message)

    return sent

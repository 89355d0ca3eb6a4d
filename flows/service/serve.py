"""The server of one command, as a program: it serves until its input ends.

Its input ends with whoever holds it, however that one ends.
"""

import sys
import threading

import uvicorn
from prefect.server.api.server import create_app

from flows.service.app import guarded

_HOST = "127.0.0.1"


def serve(port: int) -> None:
    """Serve until standard input ends.

    Args:
        port: Where to listen, on this machine only.
    """
    app = guarded(create_app(ephemeral=True, final=True), _HOST, port)
    settings = uvicorn.Config(app, _HOST, port, log_level="error", proxy_headers=False)
    server = uvicorn.Server(settings)

    def end_with_input() -> None:
        sys.stdin.buffer.read()
        server.should_exit = True

    threading.Thread(target=end_with_input, daemon=True).start()
    server.run()


if __name__ == "__main__":
    serve(int(sys.argv[1]))

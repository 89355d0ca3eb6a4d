"""A port of this machine: lines that another program of it sends."""

import select
import socket
from contextlib import suppress
from dataclasses import dataclass, field

from flows.inputs.stream.lines import Reader
from flows.inputs.stream.source import POLL, Batch, Meaning, whole_lines
from flows.settings import is_loopback
from residual.errors import InputError

_AT_ONCE = 1 << 16  # bytes


@dataclass(slots=True)
class LocalPort:
    """A port that listens on loopback, to one sender at a time.

    Attributes:
        server: What listens.
        meaning: What the lines are.
        sender: Who is connected.
        buffer: What has come of a line without an end.
    """

    server: socket.socket
    meaning: Meaning
    sender: socket.socket | None = None
    buffer: bytes = b""
    _reader: Reader | None = field(default=None, repr=False)

    @classmethod
    def at(cls, address: str, meaning: Meaning) -> "LocalPort":
        """Listen.

        Args:
            address: "PORT" or "HOST:PORT"; the host can be this machine alone.

        Raises:
            InputError: If the host is another machine, or the port is taken.
        """
        host, _, port = address.rpartition(":")
        host = host.strip("[]") or "127.0.0.1"
        if not is_loopback(host):
            raise InputError(
                f"--listen {address}: {host} can be reached from other machines; "
                "expected 127.0.0.1, ::1 or localhost. Send through a tunnel that ends "
                "here, such as ssh -R."
            )
        if not port.isdigit() or int(port) > 65535:
            raise InputError(f"--listen {address}: expected a port such as 5005.")
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        server = socket.socket(family, socket.SOCK_STREAM)
        try:
            server.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            server.bind((host, int(port)))
            server.listen(1)
            server.setblocking(False)
        except OSError as error:
            server.close()
            raise InputError(f"--listen {address}: {error.strerror}.") from error
        return cls(server, meaning)

    @property
    def port(self) -> int:
        """The port that it has."""
        return self.server.getsockname()[1]

    @property
    def name(self) -> str:
        """What messages call it."""
        return f"port {self.port}"

    def position(self) -> dict:
        """Return nothing: what was sent is not sent again."""
        return {}

    def read(self) -> Batch:
        """Return the lines that have come."""
        if self.sender is None:
            with suppress(BlockingIOError):
                self.sender, _ = self.server.accept()
                self.sender.setblocking(False)
                return Batch(notes=(f"{self.name}: a program has connected",))
            return Batch()
        try:
            new = self.sender.recv(_AT_ONCE)
        except BlockingIOError:
            return Batch()
        except OSError:
            new = b""
        if not new:
            return self._hung_up()
        return self._lines(new)

    def unfinished(self) -> bool:
        """Whether a last line has no end yet."""
        return bool(self.buffer)

    def wait(self) -> None:
        """Wait until something comes, for a moment at most."""
        select.select([self.sender or self.server], [], [], POLL)

    def close(self) -> None:
        """Stop listening."""
        for one in (self.sender, self.server):
            if one is not None:
                one.close()

    def _lines(self, new: bytes) -> Batch:
        text = self.buffer + new
        lines, used = whole_lines(text)
        self.buffer = text[used:]
        if len(self.buffer) > 1 << 20:
            raise InputError(f"{self.name}: a line of more than a megabyte.")
        if lines and self._reader is None:
            self._reader = self.meaning.reader(lines[0], self.name)
            lines = lines if lines[0].lstrip().startswith("{") else lines[1:]
        if not lines or self._reader is None:
            return Batch(more=True)
        return Batch(self._reader.samples(lines), more=True)

    def _hung_up(self) -> Batch:
        assert self.sender is not None
        self.sender.close()
        lost = ", in the middle of a line, which is left out" if self.buffer else ""
        self.sender, self.buffer, self._reader = None, b"", None
        return Batch(notes=(f"{self.name}: the program has hung up{lost}; waiting",))

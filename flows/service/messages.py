"""Prefect's broker of events, in memory, whose consumers wait for their turn to write.

Prefect loads it by the name in PREFECT_MESSAGING_BROKER, and asks of such a module the
names below.
"""

from prefect.server.utilities.messaging import MessageHandler, memory
from prefect.server.utilities.messaging.memory import (
    Publisher,
    break_topic,
    ephemeral_subscription,
)

from flows.service.database import wait_to_write

__all__ = ["Consumer", "Publisher", "break_topic", "ephemeral_subscription"]


class Consumer(memory.Consumer):
    """Hands events to one service of the server, two at a time."""

    async def run(self, handler: MessageHandler) -> None:
        """Hand events to ``handler`` until it says to stop."""
        wait_to_write()
        await super().run(handler)

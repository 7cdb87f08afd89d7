"""The bus: zenoh on loopback, keys, publishing without blocking, subscribing without losing."""

from labhil.bus.ask import Answering, ask, serve
from labhil.bus.live import announce, live_devices
from labhil.bus.publish import StreamPublisher, publish_event
from labhil.bus.session import Bus, open_bus
from labhil.bus.subscribe import Subscription, subscribe

__all__ = [
    "Answering",
    "Bus",
    "StreamPublisher",
    "Subscription",
    "announce",
    "ask",
    "live_devices",
    "open_bus",
    "publish_event",
    "serve",
    "subscribe",
]

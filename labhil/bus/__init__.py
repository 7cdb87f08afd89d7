"""The bus: zenoh on the loopback, with keys, non-blocking publishers and lossless subscriptions."""

from labhil.bus.ask import Responder, ask, serve
from labhil.bus.live import announce, live_devices
from labhil.bus.publish import StreamPublisher, publish_event
from labhil.bus.session import Bus, open_bus
from labhil.bus.subscribe import Subscription, subscribe

__all__ = [
    "Bus",
    "Responder",
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

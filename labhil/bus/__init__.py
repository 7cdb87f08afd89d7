"""The bus: zenoh on loopback, keys, publishing without blocking, subscribing without losing."""

"""From a model and a recording to estimates that can be believed."""

"""A user's own simulator as a rig that is fitted, diagnosed and verified like a built-in one.

``simulator`` is what a user states, ``probing`` tries it out, ``laws`` compiles it together with the
catalogue, ``catalogue`` says which effects its ports take, ``model`` is what an analysis works on.
"""

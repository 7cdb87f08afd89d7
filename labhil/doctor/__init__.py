"""``labhil doctor``: checks of this machine and its installation, with advice."""

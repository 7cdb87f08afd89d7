"""White-box models: laws, terms, and one simulation kernel per rig."""

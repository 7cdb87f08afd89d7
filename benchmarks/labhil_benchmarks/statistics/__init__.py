"""How far the statistics can be trusted: many simulated recordings with known answers, fitted and counted."""

"""Which terms are missing, decided by one number: the evidence of every structure, a set of added terms.

Read on in :mod:`responses` (what each term would change), :mod:`marginal` (the evidence in closed form),
:mod:`enumerate` (all structures on one linearisation), :mod:`search` (refits of the few that matter),
:mod:`stages` (short windows, then longer ones), :mod:`claims` (what is claimed) and :mod:`curves`.
"""

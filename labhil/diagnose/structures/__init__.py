"""Bayesian comparison of model structures: which terms, or which nonparametric force, a baseline model lacks.

A structure is a set of terms that are added to the baseline. Read on in :mod:`stages` (searches on windows of
increasing length, the entry point), :mod:`search` (refits of the best structures), :mod:`responses` (linear
responses of the residuals to every term), :mod:`marginal` (evidence in closed form), :mod:`disturbance`
(noise and slow disturbances), :mod:`enumerate` (beam search on one linearisation), :mod:`state` (structures
visited), :mod:`claims` (claims and their validation) and :mod:`curves` (nonparametric forces).
"""

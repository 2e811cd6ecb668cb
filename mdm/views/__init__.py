"""Plots of policies, beliefs, bounds and networks; they need matplotlib (``mdm[plot]``)."""

"""Friction levels that follow the rig: torque injection, error injection, reversal adaptation.

Pure classes over sample time: no I/O, no clock, no logging (DESIGN decision 3). Only the offsets
k0± of eq. 3 adapt; load and speed dependence stay as identified.
"""

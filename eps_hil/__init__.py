"""Hardware-in-the-loop service for electric power steering (EPS) over CAN.

Importing the package is free: every folder below is imported by the verb that needs it.
"""

__version__ = "0.1.0"

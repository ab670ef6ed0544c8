"""What ``import eps_hil`` offers: recordings and results that plot, tabulate and show themselves.

Thin: every function calls the library that the verb of its name calls. Take the names from
``eps_hil`` itself; the modules here may move.
"""

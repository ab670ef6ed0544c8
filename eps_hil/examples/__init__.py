"""Files that come with the package: configurations, models, mappings, manoeuvres, CAN databases.

They are data of the package, so that a wheel has them; a checkout's ``configs`` and ``dbc`` are
links to these folders. ``eps-hil example`` copies them out (:mod:`eps_hil.examples.shelf`).
"""

from pathlib import Path

FOLDER = Path(__file__).resolve().parent
CONFIGS = FOLDER / "configs"
DBC = FOLDER / "dbc"

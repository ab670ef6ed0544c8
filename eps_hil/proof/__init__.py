"""The proof: a rig of other code with known, concealed physics, and the judge of a diagnosis.

Nothing here imports the project's physics, estimation, identification or diagnosis, and none of
those import anything from here: what the diagnosis is examined on, it must not have been built
from. ``plant`` obeys the seed paper's equations and CONTRACT 8 in code of its own.
"""

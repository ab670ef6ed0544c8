"""Errors for people: one line, and the same one out of another process."""

import pickle

from eps_hil.errors import InputError


def test_an_input_error_comes_back_from_another_process_as_it_was() -> None:
    error = InputError("a.csv", "column x", "is not a number", "mend it")
    again = pickle.loads(pickle.dumps(error))
    assert str(again) == str(error)
    assert (again.place, again.remedy) == ("column x", "mend it")

"""Folders for results: made whole or not at all; and what JSON can hold."""

import numpy as np
import pytest

from difffric.errors import InputError
from difffric.output_folder import check_writable, open_folder, to_json_types


def test_checking_a_folder_makes_none(tmp_path):
    assert check_writable(tmp_path / "a" / "b") == tmp_path / "a" / "b"
    assert list(tmp_path.iterdir()) == []


def test_a_file_is_no_folder(tmp_path):
    (tmp_path / "file").touch()
    for folder in ("file", "file/in/it"):
        with pytest.raises(InputError, match="file is a file; --out needs a folder"):
            check_writable(tmp_path / folder)


def test_a_folder_made_for_nothing_goes_again(tmp_path):
    with pytest.raises(RuntimeError), open_folder(tmp_path / "a" / "b") as folder:
        assert folder.is_dir()
        raise RuntimeError
    assert list(tmp_path.iterdir()) == []
    with open_folder(tmp_path / "a") as folder:
        (folder / "kept").touch()
    assert (tmp_path / "a" / "kept").exists()


def test_numbers_that_do_not_exist_are_null():
    given = {"a": np.nan, "b": [np.inf, 1], "c": np.float64(2), "d": None, "e": np.bool_(True)}
    assert to_json_types(given) == {"a": None, "b": [None, 1], "c": 2.0, "d": None, "e": True}

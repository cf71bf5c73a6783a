"""What is half-written goes where a process ends within its work, and nothing else does."""

import pytest

from difffric import leftovers
from difffric.atomic_files import write_whole
from difffric.output_folder import open_folder


def test_only_what_is_begun_and_not_done_is_removed(tmp_path):
    done, begun, folder = (tmp_path / name for name in ("done", "begun", "folder"))
    with leftovers.guard(done):
        done.touch()
    with leftovers.guard(begun), leftovers.guard(folder):
        begun.touch()
        folder.mkdir()
        (folder / "part").touch()
        leftovers.remove_leftovers()
        assert list(tmp_path.iterdir()) == [done]
    leftovers.remove_leftovers()
    assert done.exists()


def test_a_file_half_written_goes_and_the_one_before_it_stays(tmp_path):
    path = tmp_path / "file"
    path.write_text("before")

    def write(file):
        file.write(b"half")
        assert len(list(tmp_path.iterdir())) == 2
        leftovers.remove_leftovers()
        assert list(tmp_path.iterdir()) == [path]

    with pytest.raises(ValueError, match="cannot be written"):  # it was taken away meanwhile
        write_whole(path, write)
    assert path.read_text() == "before"


def test_a_folder_made_for_results_goes_only_where_it_is_empty(tmp_path):
    with open_folder(tmp_path / "a" / "b") as folder:
        leftovers.remove_leftovers()
        assert list(tmp_path.iterdir()) == []
        folder.mkdir(parents=True)
        (folder / "kept").touch()
        leftovers.remove_leftovers()
        assert (folder / "kept").exists()

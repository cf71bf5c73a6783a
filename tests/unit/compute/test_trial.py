"""The process in which a stripped program is tried before this one loads it."""

from difffric.compute.programs.trial import Trial


def test_what_is_no_program_does_not_survive_and_the_process_serves_on(tmp_path):
    trial, damaged = Trial(), tmp_path / "damaged"
    damaged.write_bytes(b"no program")
    assert not trial.survives(damaged, [])
    served = trial._process
    assert not trial.survives(tmp_path / "none", [])
    assert trial._process is served and served is not None and served.poll() is None
    served.kill()
    served.wait()
    assert not trial.survives(tmp_path / "none", [])  # by another process
    assert trial._process is not served and trial._process is not None
    trial._process.kill()

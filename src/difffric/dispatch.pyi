import os
from collections.abc import Mapping, Sequence
from typing import Any, overload

from numpy.typing import ArrayLike

from difffric.axis.diagnosis.verdict import AxisDiagnosis
from difffric.axis.motion.trajectory import AxisTrajectory
from difffric.axis.recordings import AxisRecordings
from difffric.axis.result import AxisFit, AxisLevels
from difffric.axis.setup import AxisSetup
from difffric.calibration.result import Fit
from difffric.diagnosis.verdict import Diagnosis
from difffric.identification.estimators import Identified
from difffric.measurements.pushes import Pushes
from difffric.measurements.recordings import Recordings
from difffric.progress import Tell
from difffric.rig.rig import Rig
from difffric.rig.setup import Setup
from difffric.simulation.trajectory import Trajectory

@overload
def fit(
    rig: AxisSetup,
    data: AxisRecordings,
    *,
    free: Sequence[str] | None = None,
    tell: Tell = ...,
) -> AxisFit: ...
@overload
def fit(rig: Rig | Setup, data: Pushes | Recordings, **options: Any) -> Fit: ...
@overload
def identify(rig: AxisSetup | AxisFit, data: AxisRecordings, *, tell: Tell = ...) -> AxisLevels: ...
@overload
def identify(rig: Rig | Setup | Fit, data: Pushes | Recordings, **options: Any) -> Identified: ...
@overload
def diagnose(
    rig: AxisSetup, data: AxisRecordings, *, matters: float = ..., tell: Tell = ...
) -> AxisDiagnosis: ...
@overload
def diagnose(rig: Rig | Setup, data: Pushes | Recordings, **options: Any) -> Diagnosis: ...
@overload
def simulate(
    rig: AxisSetup,
    force: ArrayLike,
    time: ArrayLike,
    *,
    position: float = 0.0,
    speed: float = 0.0,
) -> AxisTrajectory: ...
@overload
def simulate(rig: Rig, velocity: ArrayLike, **options: Any) -> Trajectory: ...
def load(
    path: str | os.PathLike, *, skip_bad: bool = False, channels: Mapping[str, str] | None = None
) -> Any: ...
def load_setup(path: str | os.PathLike) -> Any: ...
def read_setup(path: str | os.PathLike) -> Any: ...

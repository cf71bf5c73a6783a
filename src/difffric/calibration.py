"""Calibration: the rig's parameters, each push's mu_s and its scatter, from measured pushes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import product
from threading import Thread

import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray
from scipy import stats

from difffric import coordinates, parameters
from difffric.coordinates import Layout, layout
from difffric.data_checks import checked_data
from difffric.errors import InputError, NumericalError
from difffric.first_search import fit_of_forces, other_branches, ranked_starts
from difffric.fit_data import (
    RECORDINGS,
    TABLE,
    FitData,
    sensor_errors,
    slides_data,
    strokes_of,
    table_data,
    traces_data,
)
from difffric.fitted import Fit
from difffric.push import Integrator, default_integrator
from difffric.pushes import Pushes
from difffric.recordings import Recordings
from difffric.reduction import Reduction, reduce_recordings
from difffric.rig import Rig
from difffric.settling import (
    ARRIVED,
    NOTHING,
    ROUNDS,
    Model,
    Settled,
    descend,
    first_point,
    linear_at,
    moved,
    settle,
    start_offsets,
    unstuck,
)
from difffric.setup_file import Setup, checked

FREE = ("k_N_per_m", "b_N_s_per_m", "k_v_N_s_per_m", "mu_s")
"""What a calibration determines by default; mu_s only where no gauge says it."""

_FACTORS = {"k_N_per_m": 3.0, "b_N_s_per_m": 3.0, "mu_s": 2.0}
"""How far off a rough guess may be: a fit starts there too."""
_SCATTER = 0.03
"""Where the scatter's estimate starts."""
_REFINED = 3
"""How many different ends of the first search are followed to the end."""
_DESCENTS = 9
"""Starts from which a first search descends."""
_BRANCHINGS = 3
_FIRST_STEPS = 25
"""Steps of the first search from each start."""
_LOOSE = 1e-5
"""How far a distance may be off [m] where it only leads to a start."""
_WORTH = 5.0
"""Ends whose chi-square is this many times the best one's are not followed."""
_ALIKE = 1e-2
"""Ends of the first search whose chi-squares differ by less than this are one."""
_FITS = 1.5
"""A reduced chi-square above this makes a fit of recordings try its other starts too."""


def _silent(what: str, share: float) -> None:
    """Progress that nobody asked for."""


def rigs_of(rig: Rig, pushes: Pushes) -> Rig:
    """The rig spread over the pushes, each with its own mass and stroke where they say so."""
    rigs = parameters.spread(rig, len(pushes))
    mass = jnp.where(jnp.isnan(pushes.mass), rigs.mass, pushes.mass)
    rigs = parameters.with_values(rigs, {"mass_kg": mass})
    _, strokes = strokes_of(rig, pushes.stroke)
    if rig.pusher.stroke is None and np.isinf(strokes).all():
        return rigs
    return parameters.with_stroke(rigs, jnp.asarray(strokes))


def fit(
    rig: Rig | Setup,
    data: Pushes | Recordings,
    *,
    free: Sequence[str] | None = None,
    per_condition: Sequence[str] = ("mu_s",),
    priors: bool = False,
    free_start: bool = False,
    robust: bool = False,
    several_starts: bool = True,
    use_data_mass: bool = False,
    skip_bad: bool = False,
    tell: Callable[[str, float], None] = _silent,
    integrator: Integrator | None = None,
) -> Fit:
    """Calibrate a rig on measured pushes: a table, whole recordings, or free slides.

    `free` parameters are by name, shared by all pushes or (`per_condition`) one for each
    condition; by default k, b, k_v and mu_s, and what the set-up's tables say. mu_s of each
    push scatters about its condition's, and the scatter is estimated with the rest (restricted
    maximum likelihood). Where every push says its `mu_s_gauge` that is its mu_s, and there is
    neither a scatter nor a free mu_s. Where no standard errors are known, the spreads of F_p
    and d are estimated too.

    `priors` takes the set-up's standard errors as knowledge from other data; its bounds always
    hold. `free_start` gives each recorded push a start offset of its own; `robust` lets
    outliers of a table weigh less (Huber); `tell(what, share done)` hears of the progress.

    Raises `InputError` for data that cannot be used (see `data_checks`), for fewer
    measurements than free parameters and for parameters that are unknown or said by the data;
    `NumericalError` where no start gives a finite misfit.
    """
    setup = rig if isinstance(rig, Setup) else Setup(rig)
    rig = checked(setup.rig)
    if isinstance(data, Recordings):
        data = checked_data(data, rig, use_data_mass=use_data_mass, skip_bad=skip_bad)
    else:
        data = checked_data(data, rig, use_data_mass=use_data_mass, skip_bad=skip_bad)
    integrator = integrator or default_integrator(rig)
    if isinstance(data, Recordings):
        tell("reducing the recordings", 0.0)
        reduction = reduce_recordings(data, skip_bad=skip_bad)
        return _Task(
            setup, reduction.pushes, reduction, free, per_condition, priors, free_start, robust,
            several_starts, tell, integrator,
        ).recordings()  # fmt: skip
    if free_start:
        raise InputError("free_start: only recordings have a start offset; these data are a table")
    return _Task(
        setup, data, None, free, per_condition, priors, False, robust, several_starts, tell,
        integrator,
    ).table()  # fmt: skip


class _Task:
    """One call of `fit`: what was asked for, and the steps to the answer."""

    def __init__(
        self, setup, pushes, reduction, free, per_condition, priors, free_start, robust,
        several_starts, tell, integrator,
    ):  # fmt: skip
        self.setup, self.pushes, self.tell = setup, pushes, tell
        self.reduction: Reduction | None = reduction
        self.several_starts, self.free_start = several_starts, free_start
        self.notes: list[str] = []
        known = not np.isnan(pushes.mu_s_gauge).any()
        if not known and np.isfinite(pushes.mu_s_gauge).any():
            self.notes.append("mu_s_gauge is not given for every push: it is not used")
        names = self._free(free, known)
        given = {"mass_kg": pushes.mass}
        if known and "mu_s" not in names:
            given["mu_s"] = pushes.mu_s_gauge
        bounds = {k: (x.lower, x.upper) for k, x in setup.extras.items()}
        errors = {k: x.standard_error for k, x in setup.extras.items() if x.standard_error}
        self.layout: Layout = layout(
            setup.rig, names, per_condition, pushes.condition, given, bounds,
            errors if priors else {},
        )  # fmt: skip
        scatter, estimate = self._scatter("mu_s" in names)
        self.model = Model(
            rig=setup.rig,
            integrator=integrator,
            layout=self.layout,
            scatter=scatter,
            estimate_scatter=estimate,
            robust=robust,
        )

    def _free(self, free, gauged: bool) -> tuple[str, ...]:
        """The names of the free parameters."""
        if free is not None:
            chosen = tuple(dict.fromkeys(free))
            if not chosen:
                known = ", ".join(parameters.names(self.setup.rig))
                raise InputError(f"free: expected some of {known}; got nothing")
            return chosen
        known = parameters.names(self.setup.rig)
        said = {k: x.free for k, x in self.setup.extras.items() if k in known}
        names = [x for x in FREE if said.get(x) is not False and x in known]
        names += [k for k, yes in said.items() if yes and k not in names]
        if gauged:
            names = [x for x in names if x != "mu_s"]
        if self.pushes.free_slides:
            names = [x for x in names if x not in ("k_N_per_m", "b_N_s_per_m")]
        return tuple(names)

    def _scatter(self, mu_free: bool) -> tuple[float, bool]:
        """The scatter where it starts or stands, and whether it is to be estimated."""
        said = self.setup.mu_s_scatter
        extras = self.setup.extras.get("friction.mu_s_scatter")
        if not mu_free:
            return 0.0, False
        if extras is not None and extras.free is False:
            return said or 0.0, False
        columns = sum(name == "mu_s" for name in self.layout.names)
        if len(self.pushes) < columns + 2:
            self.notes.append(
                "too few pushes to estimate the scatter of mu_s: "
                + (f"the set-up's {said:g} is taken" if said else "none is assumed")
            )
            return said or 0.0, False
        return said or _SCATTER, True

    def table(self) -> Fit:
        """The fit of a table, or of free slides."""
        rig, pushes = self.setup.rig, self.pushes
        if pushes.free_slides:
            data = slides_data(rig, pushes, sensor_errors(rig)[1])
        else:
            rig, data = table_data(rig, pushes, sensor_errors(rig))
        self._enough(data)
        self.model = replace(self.model, rig=rig)
        best, reached = self._search(data)
        self.tell("done", 1.0)
        return self._fit(data, best[0], reached)

    def _enough(self, data: FitData) -> None:
        if data.samples <= self.layout.n_free:
            raise InputError(
                f"fit: {data.samples} measurements cannot determine {self.layout.n_free} values"
            )

    def recordings(self) -> Fit:
        """The fit of whole recordings, from where their peaks and distances lead."""
        assert self.reduction is not None
        recordings = self.reduction.recordings
        table, samples = self.model, replace(self.model, free_start=self.free_start)
        self.model = samples
        compiling = Thread(target=self._compile, args=(recordings,), daemon=True)
        compiling.start()  # the other programs are compiled meanwhile
        best: tuple[FitData, Settled] | None = None
        tried = 0
        for search in (self._forces_first, self._tables_first, lambda model: [None]):
            try:
                starts = search(table)
            except (InputError, NumericalError):
                continue
            compiling.join()
            for start in starts:
                tried += 1
                self.tell("fitting every sample", 0.3 + 0.1 * min(tried, 6))
                try:
                    found = self._follow(recordings, start)
                except NumericalError:
                    continue
                if best is None or found[1].components.chi2 < best[1].components.chi2:
                    best, reached = found, 0
                reached += found[1].components.chi2 < best[1].components.chi2 + _ALIKE
                if best[1].components.chi2 < _FITS * best[0].samples:
                    break
            if best is not None and best[1].components.chi2 < _FITS * best[0].samples:
                break
        if best is None:
            raise NumericalError("fit: no start gives a finite misfit")
        self.tell("done", 1.0)
        return self._fit(*best, (reached, tried))

    def _loose_table(self) -> tuple[Rig, FitData]:
        """Peaks and distances, which only lead to where the samples decide."""
        rig, data = table_data(self.setup.rig, self.pushes, sensor_errors(self.setup.rig))
        sd = np.hypot(1.0 / np.maximum(data.rough, 1e-300), [0.0, _LOOSE])
        return rig, replace(data, rough=np.where(data.rough > 0, 1.0 / sd, 0.0))

    def _forces_first(self, table: Model) -> list[Settled | None]:
        """Where F_p alone and then d too lead."""
        rig, data = self._loose_table()
        model = replace(table, rig=rig)
        found = fit_of_forces(model, data, self._starts())
        if found is None:
            return []
        boxes = [found[0].theta, self.layout.start]
        return [at for _, at, _ in self._descents(model, data, boxes)[:1]]

    def _tables_first(self, table: Model) -> list[Settled | None]:
        """Where the whole search of a table leads."""
        rig, data = self._loose_table()
        self.model = replace(table, rig=rig)
        try:
            return [at for _, at, _ in self._first_search(data)[:_REFINED]]
        finally:
            self.model = replace(table, free_start=self.free_start)

    def _compile(self, recordings: Recordings) -> None:
        """Have the program that fits the samples compiled."""
        assert self.reduction is not None
        try:
            rig, data = self._traces(recordings, None)
            model = replace(self.model, rig=rig)
            at = first_point(model, data, self.layout.start)
            descend(model, data, at, at.held, data.weights, max(model.scatter, 1e-3), 1e3, 0)
        except Exception:  # the fit itself will say what is wrong
            return

    def _traces(self, recordings: Recordings, jumps: NDArray | None, stiffest: float = 0.0):
        """The samples as a fit takes them, in blocks that suit a contact `stiffest` [N/m], or
        three times as stiff as the set-up says."""
        assert self.reduction is not None
        stiffest = max(
            stiffest, _FACTORS["k_N_per_m"] * parameters.values(self.setup.rig)["k_N_per_m"]
        )
        lightest = np.nanmin([float(self.setup.rig.mass), *self.pushes.mass])
        return traces_data(
            self.setup.rig,
            recordings,
            self.reduction.details,
            float(np.sqrt(2 * stiffest / lightest)),
            len(coordinates.names(self.setup.rig)),
            jumps,
            2e-5 if self.free_start else 0.0,
        )

    def _follow(self, recordings: Recordings, start: Settled | None) -> tuple[FitData, Settled]:
        """Fit the samples, leaving out those beside the jumps of the model as it stands."""
        theta = self.layout.start if start is None else start.theta
        named = self.layout.value(theta).items()
        stiffest = max([0.0, *(v for x, v in named if x.startswith("k_N_per_m"))])
        jumps, at, rounds = None, start, ROUNDS
        while True:
            rig, data = self._traces(recordings, jumps, stiffest)
            model = replace(self.model, rig=rig)
            fresh = first_point(model, data, theta)
            if at is None:
                at = fresh
            elif jumps is None:
                at = replace(fresh, s_eta=at.s_eta)
            at = settle(model, data, at, trust=1e3, rounds=rounds)
            new = np.asarray(at.end.jumps)[: data.n]
            if rounds <= 4 or (jumps is not None and _same(jumps, new)):
                break
            jumps, rounds = new, rounds // 2
        self.model = model
        return data, at

    def _first_search(self, data: FitData) -> list[tuple[float, Settled, int]]:
        """Where the starts lead with some per cent of tolerance: the different ends, the best
        first, each with its chi-square and how many starts lead to it."""
        model = self.model
        starts = self._starts()
        if len(starts) > 1 and data.kind == TABLE:
            self.tell("looking for starts", 0.0)
            starts = ranked_starts(model, data, starts, _DESCENTS)
        return self._descents(model, data, starts)

    def _descents(
        self, model: Model, data: FitData, starts: list[NDArray]
    ) -> list[tuple[float, Settled, int]]:
        """Where descents from `starts` end."""
        rough = replace(data, weights=data.rough, group=np.full(data.group.shape, -1))
        ends: list[tuple[float, Settled]] = []
        for i, theta in enumerate(starts):
            self.tell(f"start {i + 1} of {len(starts)}", 0.4 * i / len(starts))
            at = first_point(model, data, theta)
            scatter = max(model.scatter, 0.05) if model.estimate_scatter else model.scatter
            end = descend(model, rough, at, at.held, rough.weights, scatter, 1.0, _FIRST_STEPS)
            if np.isfinite(float(end.chi2)):
                clipped = moved(at, end, at.held, scatter)
                inside = np.clip(clipped.theta, self.layout.lower, self.layout.upper)
                ends.append((float(end.chi2), replace(clipped, theta=inside)))
        if not ends:
            raise NumericalError("fit: no start gives a finite misfit")
        ends.sort(key=lambda x: x[0])
        distinct: list[tuple[float, Settled, int]] = []
        for chi2, at in ends:
            if distinct and chi2 - distinct[-1][0] < _ALIKE * (1 + chi2):
                distinct[-1] = (*distinct[-1][:2], distinct[-1][2] + 1)
            else:
                distinct.append((chi2, at, 1))
        return distinct

    def _search(self, data: FitData) -> tuple[list[Settled], tuple[int, int]]:
        """Settled fits from several starts, the best first, and how many starts lead to it."""
        model = self.model
        distinct = self._first_search(data)
        settled: list[tuple[float, Settled, int]] = []
        worth = _WORTH * (distinct[0][0] + data.samples)
        for i, (chi2, at, count) in enumerate(distinct[:_REFINED]):
            if chi2 > worth:
                break
            self.tell("settling", 0.4 + 0.03 * i)
            try:
                done = settle(model, data, replace(at, scatter=max(at.scatter, model.scatter)))
                if data.kind == TABLE:
                    done = self._on_the_best_branches(data, done)
            except NumericalError:
                continue
            settled.append((done.components.criterion, done, count))
        if not settled:
            raise NumericalError("fit: the misfit is not finite wherever the search led")
        settled.sort(key=lambda x: x[0])
        best = settled[0][0]
        reached = sum(count for c, _, count in settled if c - best < _ALIKE)
        return [at for _, at, _ in settled], (reached, sum(n for *_, n in distinct))

    def _on_the_best_branches(self, data: FitData, done: Settled) -> Settled:
        """The fit once every push's own mu_s is on the branch that fits it best."""
        for _ in range(_BRANCHINGS):
            other = unstuck(self.model, data, done, other_branches(self.model, data, done))
            if other is done:
                break
            again = settle(self.model, data, other)
            if again.components.criterion > done.components.criterion - ARRIVED:
                break
            done = again
        return done

    def _starts(self) -> list[NDArray]:
        """The set-up's own values, and a grid about its stiffness, damping and friction."""
        own = np.clip(self.layout.start, self.layout.lower, self.layout.upper)
        if not self.several_starts:
            return [own]
        names = self.layout.names
        axes = []
        for name, factor in _FACTORS.items():
            shift = np.array([x == name for x in names], float) * np.log(factor)
            if shift.any():
                axes.append([s * shift for s in (-1, 0, 1)])
        grid = [own + sum(shifts) for shifts in product(*axes)]
        inside = [np.clip(x, self.layout.lower, self.layout.upper) for x in grid]
        return [own, *(x for x in inside if not np.array_equal(x, own))]

    def _fit(self, data: FitData, at: Settled, reached) -> Fit:
        """The result."""
        model, pushes, n = self.model, self.pushes, data.n
        layout, c = self.layout, at.components
        names = layout.names
        spread = dict(zip(data.groups, c.spreads.tolist(), strict=True))
        log_mu = (layout.fixed + layout.selection @ at.theta)[:, 0] + at.s_eta
        found = layout.value(at.theta)
        new = {
            name: float(
                np.mean([v for v, x in zip(found.values(), names, strict=True) if x == name])
            )
            for name in names
        }
        for label, held in zip(layout.labels, at.held, strict=True):
            if held and label == "b_N_s_per_m" and at.theta[layout.labels.index(label)] <= -7.0:
                new["b_N_s_per_m"] = 0.0
        noise = {}
        if self.reduction is not None:
            noise = _noise(self.reduction)
        F, d = np.asarray(at.end.model)[:n].T
        fitted_numbers = int(np.sum(~at.held)) + (n if model.free_start else 0)
        offsets = n if data.kind == RECORDINGS else 0
        chi2 = c.chi2
        notes = list(self.notes)
        if not at.smooth:
            notes.append(
                "the optimum lies at a change of regime of one push or more, where derivatives "
                "jump: error bars hold for one side of it"
            )
        freedom = data.samples - fitted_numbers - offsets
        if freedom > 0 and len(data.groups) == 0:
            p = float(stats.chi2.sf(chi2, freedom))
            if p < 1e-3:
                notes.append(
                    f"chi-square is {chi2 / freedom:.3g} times what the noise explains: the model "
                    "lacks something, the noise is larger than said, or this is not the optimum"
                )
        return Fit(
            rig=parameters.with_values(self.setup.rig, new),
            kind=data.kind,
            free=layout.labels,
            names=names,
            theta=at.theta,
            held=tuple(x for x, on in zip(layout.labels, at.held, strict=True) if on),
            covariance=c.covariance,
            ahead=np.where(at.held, c.step, 0.0),
            freedom=c.freedom,
            scatter=at.scatter,
            scatter_se=float(c.relative_errors[0] * at.scatter) if at.scatter else np.nan,
            spread_force=spread.get("force", np.nan),
            spread_distance=spread.get("distance", np.nan),
            chi2=chi2,
            degrees_of_freedom=freedom,
            converged=at.settled,
            starts_at_optimum=reached,
            conditions=tuple(pushes.condition),
            mu_s=np.exp(log_mu),
            mu_s_se=np.exp(log_mu) * _own_errors(model, data, at),
            start=start_offsets(at),
            peak_force=F,
            sliding_distance=d,
            noise=noise,
            samples=data.samples,
            left_out=data.left_out,
            notes=tuple(notes),
            skipped=pushes.skipped,
            setup=self.setup,
            work=(model, data, at),
        )


def _same(old: NDArray, new: NDArray) -> bool:
    return old.shape == new.shape and bool(np.allclose(old, new, atol=2e-6, rtol=0))


def _noise(reduction: Reduction) -> dict[str, dict[str, float]]:
    """Level and correlation of the channels' noise, of the first push that has them."""
    out = {}
    for name in ("force", "position"):
        known = [getattr(x, f"noise_{name}") for x in reduction.details]
        known = [x for x in known if x is not None]
        if known:
            out[name] = {
                "standard_deviation": float(np.median([x.level for x in known])),
                "correlation": float(np.median([x.correlation for x in known])),
            }
    return out


def _own_errors(model: Model, data: FitData, at: Settled) -> NDArray:
    """Relative standard error of each push's own mu_s (n,), that of the shared parameters
    carried through."""
    P = model.layout.n_free
    felt = ~(at.held & (at.theta <= NOTHING))
    L = linear_at(model, data, replace(at, held=~felt))
    G = L.known + np.einsum("gnij,g->nij", L.groups, 1.0 / at.components.spreads**2)
    column = G[:, :, P]
    on = G[:, P, P] > 0
    G = G - np.einsum("ni,nj->nij", column, column / np.where(on, G[:, P, P], 1.0)[:, None])
    own = at.scatter**2 / (1 + at.scatter**2 * np.maximum(G[:, P + 1, P + 1], 0))
    J = (model.layout.selection * felt)[:, 0] - own[:, None] * G[:, P + 1, :P]
    return np.sqrt(own + np.einsum("np,pq,nq->n", J, at.components.covariance, J))

"""The figures of the study of diagnoses: alarms, names, sizes, gains."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from scipy import stats

from difffric.diagnosis.score_test import SIGNIFICANT
from studies import reliability
from studies.calibration_figures import Share
from tests.hidden.case import COMPONENTS
from tests.hidden.sizes import AMPLITUDES

LEVEL = 0.95
FEW = 7.0
"""s below which the predicted drop of chi-square is compared with the refit's."""
UNMOVED = 1e-9
"""A relative error of mu_s below which a fit has not moved."""
SCANNED = ("stribeck", "friction_waviness", "friction_patch", "pusher_ripple", "force_saturation")
"""Effects that have no score test at their null."""
ONE = (
    "s = 4", "s = 6", "s = 10", "s = 30", "typical", "tables of 24", "tables of 100",
    "with nuisances", "background, 3 %", "background, 1 %", "three times, 3 %",
)  # fmt: skip
"""Groups in whose cases one effect is hidden."""


def answered(lines: Sequence[dict]) -> list[dict]:
    """The cases that were made and diagnosed."""
    return [line for line in lines if "error" not in line and "skipped" not in line]


def with_one(everything: Mapping[str, Sequence[dict]]) -> list[dict]:
    """The cases in which one effect was hidden."""
    return [line for group in ONE for line in answered(everything.get(group, ()))]


def sets(line: dict) -> list[set[str]]:
    """The effects that each cause stands for."""
    return [{cause["id"], *cause["confusable_with"]} for cause in line["causes"]]


def first_right(line: dict) -> bool:
    """Whether the first cause's set holds what is hidden."""
    named = sets(line)
    return bool(named) and any(effect in named[0] for effect in line["effects"])


def spurious(line: dict) -> bool:
    """Whether a cause is named that stands for nothing that is hidden."""
    return any(not some & set(line["effects"]) for some in sets(line))


def share(lines: Sequence[dict], of: Callable[[dict], bool]) -> Share:
    """In how many of them."""
    return Share(sum(bool(of(line)) for line in lines), len(lines))


def upper(found: Share) -> float:
    """The upper 95 % confidence limit of a share (Clopper and Pearson)."""
    return float(stats.beta.ppf(LEVEL, found.k + 1, found.n - found.k)) if found.k < found.n else 1


def gained(line: dict) -> float | None:
    """What was gained on held-out pushes, as a share of what the true model gains; None where
    that gains less than a thousandth of the noise."""
    true, gain = line.get("true_model"), line["gain"]
    if true is None:
        return None
    before, after = gain["heldout_nrmse_before"] ** 2, gain["heldout_nrmse_after"] ** 2
    best = before - true["heldout_nrmse"] ** 2
    return (before - after) / best if best > 2e-3 else None


def compare_friction(line: dict) -> float | None:
    """The error of mu_s after the diagnosis, by that of the true model's; None where this is not
    known, or its fit did not leave the truth from which it began."""
    true = line.get("true_model")
    moved = true is not None and true["mu_s_error"] > UNMOVED
    return line["mu_s_error"] / true["mu_s_error"] if moved else None


def worse(line: dict) -> bool:
    """Whether held-out pushes are predicted worse by more than 1 % than without the causes."""
    gain = line["gain"]
    return gain["heldout_nrmse_after"] > 1.01 * gain["heldout_nrmse_before"]


def sized(line: dict) -> list[bool]:
    """Whether each number of the effect is within three standard errors of the truth, where it is
    named alone and has the catalogue's form."""
    out = []
    for cause in line["causes"]:
        if cause["id"] in line["effects"] and not line["another_form"]:
            truth = line["effects"][cause["id"]]
            for key, x in cause["parameters"].items():
                away = x["value"] - truth[key]
                if key == "phase_rad":
                    away = (away + np.pi) % (2 * np.pi) - np.pi
                out.append(abs(away) <= 3 * x["standard_error"])
    return out


def signed(line: dict) -> list[bool]:
    """Whether the effect has the truth's sign, a case each in which it is named."""
    out = []
    for cause in line["causes"]:
        if cause["id"] in line["effects"]:
            found = {key: x["value"] for key, x in cause["parameters"].items()}
            size = AMPLITUDES[cause["id"]].size
            out.append(size(found) * size(line["effects"][cause["id"]]) > 0)
    return out


def predicted(line: dict) -> float | None:
    """Predicted drop of chi-square by the refit's, of what is hidden and first."""
    for cause in line["considered"]:
        if cause["id"] in line["effects"] and cause["chi2_drop_predicted"] and line["s"] < FEW:
            return cause["chi2_drop_predicted"] / cause["chi2_drop"]
    return None


def _percent(x: float) -> str:
    return f"{100 * x:.1f} %"


def _numbers(values: Sequence[float | None]) -> np.ndarray:
    return np.array([x for x in values if x is not None], float)


def _flat(lines: Sequence[dict], of: Callable[[dict], list[bool]]) -> Share:
    every = [x for line in lines for x in of(line)]
    return Share(sum(every), len(every))


def is_unexplained(line: dict) -> bool:
    """Whether the cause is said to be outside the catalogue."""
    return line["verdict"] == "unexplained"


def clean_rows(lines: Sequence[dict]) -> list[tuple[str, str]]:
    """Of data in which nothing is hidden."""
    alarms = share(lines, lambda x: bool(x["causes"]))
    return [
        ("something named (asked: 1 %)", f"{alarms}, at most {_percent(upper(alarms))}"),
        ("`unexplained`", str(share(lines, is_unexplained))),
        interval_row(lines),
    ]


def is_sure(line: dict) -> bool:
    """Whether the hidden effect's own test, fitted from the truth, is significant."""
    true = line.get("true_model")
    return true is not None and true.get("p_value", 1.0) < SIGNIFICANT


def interval_row(lines: Sequence[dict]) -> tuple[str, str]:
    """How often the intervals of mu_s hold the friction that a push had."""
    held = [x["mu_s_within"] for x in lines if "mu_s_within" in x]
    share_held = _percent(float(np.mean(held))) if held else "-"
    return "95 % intervals of mu_s that hold it (asked: 93 to 97 %)", share_held


def _oracle_rows(
    lines: Sequence[dict], local: Sequence[dict], scanned: Sequence[dict]
) -> list[tuple[str, str]]:
    """How often the truth's own test is significant, and how often it is then named first, of
    effects with a score test and of those that are scanned; nothing where no such test was made."""
    if not any(x.get("true_model") for x in lines):
        return []
    sure = [[x for x in some if is_sure(x)] for some in (local, scanned)]
    return [
        ("the truth's own test is significant", str(share(lines, is_sure))),
        ("first set holds the truth, of these (asked: 97 %)", str(share(sure[0], first_right))),
        ("the same, effects that are scanned (asked: 93 %)", str(share(sure[1], first_right))),
    ]


def hidden_rows(lines: Sequence[dict]) -> list[tuple[str, str]]:
    """Of data in which one effect of the catalogue is hidden."""
    local = [x for x in lines if not set(x["effects"]) & set(SCANNED)]
    scanned = [x for x in lines if set(x["effects"]) & set(SCANNED)]
    named = [x for x in lines if x["causes"]]
    sizes = [len(sets(x)[0]) for x in named]
    size = [("median size of the first set", f"{np.median(sizes):.0f}")] if named else []
    rows = [
        ("first set holds the truth, effects with a score test", str(share(local, first_right))),
        ("the same, effects that are scanned", str(share(scanned, first_right))),
        *_oracle_rows(lines, local, scanned),
        ("the truth in the first set, of those that name any", str(share(named, first_right))),
        ("a cause that stands for nothing hidden", str(share(lines, spurious))),
        *size,
        ("falsely `unexplained`", str(share(lines, is_unexplained))),
        ("within three standard errors of the true size", str(_flat(lines, sized))),
        ("the right sign of the effect", str(_flat(lines, signed))),
        interval_row(lines),
    ]
    return rows + gain_rows(lines)


def gain_rows(lines: Sequence[dict]) -> list[tuple[str, str]]:
    """What held-out pushes say."""
    rows = [("held-out error worse by more than 1 %", str(share(lines, worse)))]
    gain = _numbers([gained(x) for x in lines])
    if len(gain):
        low, middle = np.percentile(gain, [5, 50])
        text = f"{middle:.3f}, {low:.2f} ({len(gain)} cases)"
        rows.insert(
            0,
            (
                "held-out gain by the true model's: median (asked: 0.95), 5th percentile (0.80)",
                text,
            ),
        )
    error = _numbers([compare_friction(x) for x in lines])
    if len(error):
        middle, high = np.percentile(error, [50, 95])
        text = f"{middle:.2f}, {high:.2f} ({len(error)} cases)"
        rows.append(("error of mu_s by the true model's: median (1.2), 95th percentile (2)", text))
    ratio = _numbers([predicted(x) for x in lines])
    if len(ratio):
        off = np.abs(ratio - 1) <= 0.1
        text = f"{_percent(off.mean())} of {len(ratio)}; median ratio {np.median(ratio):.2f}"
        rows.append(("predicted drop of chi-square within 10 % of the refit's (s < 7)", text))
    return rows


def are_all_named(line: dict) -> bool:
    """Whether every hidden effect is in the set of a cause."""
    return all(any(effect in some for some in sets(line)) for effect in line["effects"])


def is_located(line: dict) -> bool:
    """Whether the misfit is located in a component where something is hidden."""
    return line["location"] in line["components"]


def pair_rows(lines: Sequence[dict]) -> list[tuple[str, str]]:
    """Of data in which two effects are hidden."""

    def one(line):
        return any(any(effect in some for some in sets(line)) for effect in line["effects"])

    return [
        ("both named (asked: 90 %)", str(share(lines, are_all_named))),
        ("one of them at least", str(share(lines, one))),
        ("a spurious cause (asked: 3 %)", str(share(lines, spurious))),
        ("falsely `unexplained`", str(share(lines, is_unexplained))),
        *gain_rows(lines),
    ]


def ends_at_floor(line: dict) -> bool:
    """Whether the error on held-out pushes is the noise's, to a twentieth."""
    gain = line["gain"]
    return gain["heldout_nrmse_after"] < 1.05 * gain["noise_floor"]


def strong_rows(lines: Sequence[dict]) -> list[tuple[str, str]]:
    """Of data in which one effect is 10 to 100 times the noise."""
    short = [line for line in lines if not ends_at_floor(line)]
    return [
        ("held-out error within 5 % of the floor (asked: 95 %)", str(share(lines, ends_at_floor))),
        ("the others say so", str(share(short, lambda x: x["remaining"] is not None))),
        ("first set holds the truth", str(share(lines, first_right))),
        ("`adequate`: detected, and too small to matter", str(share(lines, is_adequate))),
    ]


def is_adequate(line: dict) -> bool:
    """Whether nothing is named."""
    return line["verdict"] == "adequate"


def outsider_rows(lines: Sequence[dict]) -> list[tuple[str, str]]:
    """Of data in which something is hidden that the catalogue does not have."""
    there = [line for line in lines if is_unexplained(line)]
    named = [line for line in lines if line["causes"]]

    def beside(line):
        return line["causes"][0]["component"] in line["components"]

    return [
        ("`unexplained` (asked: 90 %)", str(Share(len(there), len(lines)))),
        ("the right component, of those (asked: 85 %)", str(share(there, is_located))),
        ("of the others, an effect of the right component first", str(share(named, beside))),
    ]


def rows_of(group: str, lines: Sequence[dict]) -> list[tuple[str, str]]:
    """A group's figures."""
    good = answered(lines)
    own = {"pairs": pair_rows, "outsiders": outsider_rows, "strong": strong_rows}
    find = own.get(group.partition(",")[0], hidden_rows)
    rows = (clean_rows if group.startswith("clean") or group == "background" else find)(good)
    broken = [line["case"] for line in lines if "error" in line]
    seconds = np.median([x["seconds"] for x in good]) if good else np.nan
    return [
        ("cases", str(len(good))),
        *rows,
        *([("no answer", ", ".join(map(str, broken)))] if broken else []),
        ("median time", f"{seconds:.0f} s"),
    ]


def markdown(everything: Mapping[str, Sequence[dict]]) -> str:
    """All figures, a table a group."""
    parts = []
    for group, lines in everything.items():
        if lines:
            title = group if "=" in group else group.capitalize()
            parts += [f"### {title}", table(rows_of(group, lines))]
    one = with_one(everything)
    if one:
        parts += [
            "### Stated probabilities, one effect hidden",
            "\n".join(reliability.tabulate(one)),
        ]
    return "\n\n".join(parts)


def table(rows: Sequence[tuple[str, str]]) -> str:
    """Two columns."""
    return "\n".join(["| | |", "| --- | --- |", *(f"| {name} | {x} |" for name, x in rows)])


def confusion(everything: Mapping[str, Sequence[dict]], path: Path) -> None:
    """What was hidden against what was named first, as a picture."""
    from matplotlib.figure import Figure

    lines = with_one(everything)
    if not lines:
        return
    names = [e for e in COMPONENTS if any(e in x["effects"] for x in lines)]
    columns = [*names, "adequate", "unexplained"]
    count = np.zeros((len(names), len(columns)))
    for x in lines:
        said = x["causes"][0]["id"] if x["causes"] else x["verdict"]
        hidden = next(iter(x["effects"]))
        alike = x["causes"] and hidden in sets(x)[0]
        said = hidden if alike else said
        if said in columns:
            count[names.index(hidden), columns.index(said)] += 1
    share_of = count / np.maximum(count.sum(axis=1, keepdims=True), 1)
    figure = Figure(figsize=(10.5, 9), layout="constrained")
    axes = figure.add_subplot()
    axes.imshow(share_of, cmap="Blues", vmin=0, vmax=1)
    for (i, j), n in np.ndenumerate(count):
        if n:
            axes.text(j, i, f"{n:.0f}", ha="center", va="center", fontsize=8,
                      color="white" if share_of[i, j] > 0.5 else "black")  # fmt: skip
    axes.set_xticks(range(len(columns)), columns, rotation=60, ha="right", fontsize=8)
    axes.set_yticks(range(len(names)), names, fontsize=8)
    axes.set_xlabel("first cause named (its set counted as the truth where it holds it)")
    axes.set_ylabel("hidden")
    figure.savefig(path, dpi=110)


def told(line: dict) -> str:
    """One case in a line."""
    head = f"{line['group']} {line['case']}: "
    if "skipped" in line or "error" in line:
        return head + line.get("error", line.get("skipped", ""))
    truth = {**line["effects"], **line["outsider"]}
    said = []
    for cause in line["causes"]:
        sizes = ", ".join(f"{k} {x['value']:.4g}" for k, x in cause["parameters"].items())
        alike = "/".join(["", *cause["confusable_with"]])
        said.append(f"{cause['id']}{alike} ({sizes}; drop {cause['chi2_drop']:.0f})")
    small = [c["id"] for c in line["negligible"]]
    gain = line["gain"]
    true = line.get("true_model")
    best = f" (true {true['heldout_nrmse']:.3f}, {true['better_by']:+.1f})" if true else ""
    return (
        f"{head}{_short(truth)} s {line['s']:.3g} -> {line['verdict']} "
        f"{line['location'] or ''} {'; '.join(said)} "
        f"small {small} held out {gain['heldout_nrmse_before']:.3f} "
        f"{gain['heldout_nrmse_after']:.3f}{best}, {line['seconds']:.0f} s"
    )


def _short(truth: dict) -> str:
    return "; ".join(
        f"{name} ({', '.join(f'{k} {x:.4g}' for k, x in values.items())})"
        for name, values in truth.items()
    )

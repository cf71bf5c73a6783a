"""The figures of the study of diagnoses: alarms, names, sizes, gains."""

from __future__ import annotations


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
    return (
        f"{head}{_short(truth)} s {line['s']:.3g} -> {line['verdict']} "
        f"{line['location'] or ''} {'; '.join(said)} "
        f"small {small} held out {gain['heldout_nrmse_before']:.3f} "
        f"{gain['heldout_nrmse_after']:.3f}, {line['seconds']:.0f} s"
    )


def _short(truth: dict) -> str:
    return "; ".join(
        f"{name} ({', '.join(f'{k} {x:.4g}' for k, x in values.items())})"
        for name, values in truth.items()
    )

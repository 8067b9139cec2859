"""The files of KUKA controllers: variables, submit interpreter and IR_STOPM."""

import re
from collections.abc import Sequence

from planner.problem import Controller
from planner.proof.language_contribution import ControllerPower


def controller_files(power: ControllerPower) -> list[str]:
    """Return the faults of the files of a KUKA controller."""
    controller, arm, partner = power.context.problem.cell.controller, power.tasks[0].arm.name, power.partner
    runs = "$PRO_ACT AND $PERI_RDY"
    watched, known = (partner.watched(runs), [partner.seen]) if partner else ([], [])
    runs += f" AND {partner.input}" if partner else ""
    flags, submit, stopped = _power_files(controller, arm, power.signals, power.burning, runs)
    declared = [f"DECL BOOL {name}=FALSE" for name in [*flags, *known]]
    wanted = {"config_user.dat": declared, "sps_user.sub": [*watched, *submit]}
    if power.signals:
        wanted["ir_stopm_user.src"] = stopped
    faults = power.misnamed(tuple(wanted))
    if faults:
        return faults
    for name, lines in wanted.items():
        got, want = krl_lines(power.files[name]), krl_lines("\n".join(lines))
        if got != want:
            at = next((i for i, (g, w) in enumerate(zip(got, want, strict=False)) if g != w), None)
            place = min(len(got), len(want)) if at is None else at
            here, there = (rows[place] if place < len(rows) else "the end" for rows in (got, want))
            faults.append(f"{name} does not do what it is to: {here!r} stands where {there!r} is to be")
    return faults


def _power_files(
    controller: Controller, arm: str, signals: Sequence[str], lit: frozenset[str], runs: str
) -> tuple[list[str], list[str], list[str]]:
    """Of a KUKA controller the variables that are declared, the lines of the submit interpreter, and those of
    IR_STOPM; ``runs`` says that the program runs."""
    numbers = {signal: controller.number(arm, signal) for signal in signals}
    flags = {signal: "TANDEM_LIT" if signal in lit else "TANDEM_CUT" for signal in signals}
    back = [
        line
        for signal, number in numbers.items()
        for line in (f"IF $OUT[{number}] THEN", f"{flags[signal]}=TRUE", "ENDIF", f"$OUT[{number}]=FALSE")
    ]
    real = {n: controller.number(arm, controller.interlock.of(s).signal) for s, n in numbers.items()}
    follow = [f"$OUT[{out}]=$OUT[{n}] AND {runs}" for n, out in real.items() if out is not None]
    ended = ["IF $PRO_STATE1==#P_RESET THEN", "TANDEM_LIT=FALSE", "ENDIF", "IF TANDEM_LIT THEN"]
    ended += [
        *(f"$OUT[{numbers[signal]}]=FALSE" for signal in signals if signal in lit),
        "$OV_PRO=0",
        "ENDIF",
    ]
    held = ["IF TANDEM_CUT THEN", "$OV_PRO=0", "ENDIF"]
    known = [flag for flag in ("TANDEM_CUT", "TANDEM_LIT") if flag in flags.values()]
    submit = [f"IF NOT({runs}) THEN", *back, "ENDIF"] if signals else []
    submit += [*(ended if "TANDEM_LIT" in known else []), *follow, *(held if "TANDEM_CUT" in known else [])]
    return known, submit, [*back, *(f"$OUT[{out}]=FALSE" for out in real.values() if out is not None)]


def krl_lines(text: str) -> list[str]:
    """Statements of KRL text, without comments and folds, in capitals and without the spaces that count for
    nothing."""
    lines = (re.sub(r";.*", "", line) for line in text.replace("\r\n", "\n").split("\n"))
    tight = (re.sub(r"\s*([=(),\[\]])\s*", r"\1", " ".join(line.split())) for line in lines)
    return [line.upper() for line in tight if line]

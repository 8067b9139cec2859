"""Checks the files of KUKA controllers: variables, submit interpreter and IR_STOPM."""

import re
from collections.abc import Sequence

from planner.problem import Controller
from planner.proof.language_contribution import ControllerPower


def controller_files(power: ControllerPower) -> list[str]:
    """Return the faults of the files of a KUKA controller, by comparison with the expected statements.

    If the names of the files are wrong, only these faults are returned. Otherwise there is a fault for each
    file that differs, with its first different statement.
    """
    controller, arm, partner = power.context.problem.cell.controller, power.tasks[0].arm.name, power.partner
    runs = "$PRO_ACT AND $PERI_RDY"
    partner_lines: list[str] = []
    partner_flags: list[str] = []
    if partner:
        partner_lines, partner_flags = partner.submit_lines(runs), [partner.seen_flag]
        runs += f" AND {partner.input}"
    flags, submit, stopped = _power_files(controller, arm, power.signals, power.burning, runs)
    declared = [f"DECL BOOL {name}=FALSE" for name in [*flags, *partner_flags]]
    expected = {"config_user.dat": declared, "sps_user.sub": [*partner_lines, *submit]}
    if power.signals:
        expected["ir_stopm_user.src"] = stopped
    faults = power.file_name_faults(tuple(expected))
    if faults:
        return faults
    for name, lines in expected.items():
        actual_lines, expected_lines = krl_lines(power.files[name]), krl_lines("\n".join(lines))
        if actual_lines != expected_lines:
            first_difference = next(
                (i for i, (a, b) in enumerate(zip(actual_lines, expected_lines, strict=False)) if a != b),
                None,
            )
            index = (
                min(len(actual_lines), len(expected_lines)) if first_difference is None else first_difference
            )
            actual_line, expected_line = (
                text[index] if index < len(text) else "the end" for text in (actual_lines, expected_lines)
            )
            faults.append(
                f"{name} differs from its expected text: got {actual_line!r}, expected {expected_line!r}"
            )
    return faults


def _power_files(
    controller: Controller, arm: str, signals: Sequence[str], torches: frozenset[str], runs: str
) -> tuple[list[str], list[str], list[str]]:
    """Return expected variables, lines of the submit interpreter, and lines of IR_STOPM of a KUKA controller.

    ``runs`` is the condition that the program runs, ``torches`` are the signals that light a torch.
    """
    numbers = {signal: controller.signal_number(arm, signal) for signal in signals}
    flags = {signal: "TANDEM_LIT" if signal in torches else "TANDEM_CUT" for signal in signals}
    reset_lines = [
        line
        for signal, number in numbers.items()
        for line in (f"IF $OUT[{number}] THEN", f"{flags[signal]}=TRUE", "ENDIF", f"$OUT[{number}]=FALSE")
    ]
    output_numbers = {
        number: controller.signal_number(arm, controller.interlock.power_output(signal).signal)
        for signal, number in numbers.items()
    }
    output_lines = [
        f"$OUT[{out}]=$OUT[{number}] AND {runs}" for number, out in output_numbers.items() if out is not None
    ]
    torch_lock = ["IF $PRO_STATE1==#P_RESET THEN", "TANDEM_LIT=FALSE", "ENDIF", "IF TANDEM_LIT THEN"]
    torch_lock += [
        *(f"$OUT[{numbers[signal]}]=FALSE" for signal in signals if signal in torches),
        "$OV_PRO=0",
        "ENDIF",
    ]
    power_lock = ["IF TANDEM_CUT THEN", "$OV_PRO=0", "ENDIF"]
    used_flags = [flag for flag in ("TANDEM_CUT", "TANDEM_LIT") if flag in flags.values()]
    submit = [f"IF NOT({runs}) THEN", *reset_lines, "ENDIF"] if signals else []
    submit += [
        *(torch_lock if "TANDEM_LIT" in used_flags else []),
        *output_lines,
        *(power_lock if "TANDEM_CUT" in used_flags else []),
    ]
    return (
        used_flags,
        submit,
        [*reset_lines, *(f"$OUT[{out}]=FALSE" for out in output_numbers.values() if out is not None)],
    )


def krl_lines(text: str) -> list[str]:
    """Return the statements of KRL text in capitals, without comments, folds and insignificant spaces."""
    lines = (re.sub(r";.*", "", line) for line in text.replace("\r\n", "\n").split("\n"))
    tight = (re.sub(r"\s*([=(),\[\]])\s*", r"\1", " ".join(line.split())) for line in lines)
    return [line.upper() for line in tight if line]

"""Power at stops of KRL programs."""

from __future__ import annotations

from collections.abc import Sequence

from planner.problem import Controller


def krl_files(
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

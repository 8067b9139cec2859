"""Faults in the running wires between two controllers, by kind.

Each mutator takes a random generator, the files, and the folder of the controller.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tests.proof.controller_mutants import swap, without
from tests.proof.registry import Texts
from tests.proof.registry import named as mutator

Mutator = Callable[[np.random.Generator, Texts, str], Texts]
ABB: dict[str, Mutator] = {}
KUKA: dict[str, Mutator] = {}
CYCLE, MOTORS = "soCycleOn", "soMotorsOn"


def either(rng, *options):
    """One of the options."""
    return options[rng.integers(len(options))]


@mutator(ABB)
def inversion_missing(rng, texts, folder):
    return swap(texts, folder + "EIO.cfg", r"\s*\\?\s*-Act1_invert", "", rng)


@mutator(ABB)
def inversion_on_more(rng, texts, folder):
    return swap(texts, folder + "EIO.cfg", r'(-Act(\d) "so\w+")', r"\1 -Act\2_invert", rng)


@mutator(ABB)
def inversion_with_a_value(rng, texts, folder):
    new = either(rng, "-Act1_invert FALSE", '-Act1_invert "0"')
    return swap(texts, folder + "EIO.cfg", "-Act1_invert", new, rng)


@mutator(ABB)
def other_action(rng, texts, folder):
    new = either(rng, "Start", "StopCycle", "MotorsOn", "Interrupt", "Stop at End")
    return swap(texts, folder + "EIO.cfg", r'-Action "Stop"', f'-Action "{new}"', rng)


@mutator(ABB)
def stop_by_another_signal(rng, texts, folder):
    new = either(rng, "diPartnerRunning", "diPartner", "doRunning")
    pattern = r'-Signal "diPartnerRunning_lost"'
    return swap(texts, folder + "EIO.cfg", pattern, f'-Signal "{new}"', rng)


@mutator(ABB)
def stop_missing(rng, texts, folder):
    return without(texts, folder + "EIO.cfg", "-Action|^SYSSIG_IN", rng)


@mutator(ABB)
def more_system_inputs(rng, texts, folder):
    row = f'\n      -Signal "diPartnerRunning" -Action "{either(rng, "Start", "MotorsOn", "Stop")}"\n'
    return swap(texts, folder + "EIO.cfg", r'(-Action "Stop")', rf"\1{row}", rng)


@mutator(ABB)
def term_of_running_missing(rng, texts, folder):
    new = either(rng, rf'-Act1 "{CYCLE}"', rf'-Act1 "{MOTORS}"')
    pattern = rf'-Act1 "{CYCLE}" -Oper1 "AND"\s*\\?\s*-Act2 "{MOTORS}"'
    return swap(texts, folder + "EIO.cfg", pattern, new, rng)


@mutator(ABB)
def or_of_states(rng, texts, folder):
    return swap(texts, folder + "EIO.cfg", r'-Oper(\d) "AND"', r'-Oper\1 "OR"', rng)


@mutator(ABB)
def wires_crossed(rng, texts, folder):
    file = folder + "EIO.cfg"
    a, b = either(
        rng,
        ("doRunning", "diPartnerRunning"),
        ("diPartnerRunning", "diPartnerRunning_lost"),
        ("doRunning", "diPartnerRunning_lost"),
    )
    text = texts[file].replace(f'"{a}"', '"@"').replace(f'"{b}"', f'"{a}"').replace('"@"', f'"{b}"')
    return {**texts, file: text}


@mutator(ABB)
def output_of_the_program(rng, texts, folder):
    access = either(rng, "", ' -Access "All"', ' -Access "TandemRequest"')
    pattern = r'("doRunning" -SignalType "DO"(?: -Device "\w+" -DeviceMap "\d+")?)\s*\\?\s*-Access "ReadOnly"'
    return swap(texts, folder + "EIO.cfg", pattern, r"\1" + access, rng)


@mutator(ABB)
def driven_by_something_else(rng, texts, folder):
    new = either(rng, "doPartner", "diPartner", "diPartnerRunning")
    return swap(texts, folder + "EIO.cfg", rf'-Act1 "{CYCLE}"', f'-Act1 "{new}"', rng)


@mutator(ABB)
def row_of_wires_missing(rng, texts, folder):
    pattern = r'-(Name "(doRunning|diPartner\w*|TandemPartner)"|Status|Signal)'
    return without(texts, folder + "EIO.cfg", pattern, rng)


@mutator(ABB)
def one_more_cross(rng, texts, folder):
    more = either(
        rng,
        '-Name "More" -Res "doRunning" -Act1 "diPartner"',
        '-Name "More" -Res "diPartnerRunning" -Act1 "soCycleOn"',
        '-Name "More" -Res "diPartnerRunning_lost" -Act1 "diPartner"',
    )
    text = texts[folder + "EIO.cfg"]
    return {**texts, folder + "EIO.cfg": f"{text}\n      {more}\n"}


@mutator(ABB)
def of_another_kind(rng, texts, folder):
    pattern = r'("(?:doRunning|diPartnerRunning)" -SignalType) "D(?:I|O)"'
    return swap(texts, folder + "EIO.cfg", pattern, rf'\1 "{either(rng, "GI", "AO")}"', rng)


@mutator(ABB)
def at_another_place(rng, texts, folder):
    pattern = either(rng, r'-Device "\w+"( -DeviceMap "[67]")', r'-Device "(\w+)" -DeviceMap "[67]"')
    new = either(rng, r'-Device "Else"\1', "") if "(\\w+)" not in pattern else r'-Device "\1" -DeviceMap "9"'
    return swap(texts, folder + "EIO.cfg", pattern, new, rng)


@mutator(ABB)
def wires_file_missing(rng, texts, folder):
    return {name: text for name, text in texts.items() if name != folder + "EIO.cfg"}


@mutator(ABB)
def file_left_over(rng, texts, folder):
    name = either(rng, "sps_user.sub", "PROC.cfg", "TandemPower.mod")
    return {**texts, folder + name: texts[folder + "EIO.cfg"]}


@mutator(KUKA)
def latch_missing(rng, texts, folder):
    file = folder + "sps_user.sub"
    gone = either(rng, r" OR NOT TANDEM_SEEN", r"(?m)^TANDEM_SEEN=(TRUE|FALSE)\r?\n", r"\$IN\[2\] OR ")
    return swap(texts, file, gone, "", rng)


@mutator(KUKA)
def latch_the_other_way(rng, texts, folder):
    old, new = either(
        rng, ("TANDEM_SEEN=FALSE", "TANDEM_SEEN=TRUE"), ("OR NOT TANDEM_SEEN", "OR TANDEM_SEEN")
    )
    return swap(texts, folder + "sps_user.sub", old, new, rng)


@mutator(KUKA)
def latch_kept_at_a_stop(rng, texts, folder):
    return swap(texts, folder + "sps_user.sub", r"IF NOT \$PRO_ACT THEN", "IF NOT $PERI_RDY THEN", rng)


@mutator(KUKA)
def numbers_swapped(rng, texts, folder):
    file = folder + "sps_user.sub"
    a, b = either(rng, ("$OUT[2]", "$OUT[3]"), ("$OUT[2]", "$IN[2]"), ("$OUT[3]", "$IN[2]"))
    text = texts[file].replace(a, "@").replace(b, a).replace("@", b)
    return {**texts, file: text}


@mutator(KUKA)
def other_number(rng, texts, folder):
    new = rf"$\1[{rng.integers(50, 90)}]"
    return swap(texts, folder + "sps_user.sub", r"\$(IN|OUT)\[[23]\]", new, rng)


@mutator(KUKA)
def input_turned_over(rng, texts, folder):
    return swap(texts, folder + "sps_user.sub", r"\$IN\[2\]", "(NOT $IN[2])", rng)


@mutator(KUKA)
def or_for_and(rng, texts, folder):
    return swap(texts, folder + "sps_user.sub", r"\bAND\b", "OR", rng)


@mutator(KUKA)
def and_for_or(rng, texts, folder):
    return swap(texts, folder + "sps_user.sub", r"\bOR\b", "AND", rng)


@mutator(KUKA)
def state_missing(rng, texts, folder):
    return swap(texts, folder + "sps_user.sub", r"\$PRO_ACT AND |AND \$PERI_RDY", "", rng)


@mutator(KUKA)
def line_missing(rng, texts, folder):
    file = either(rng, "sps_user.sub", "config_user.dat")
    return without(texts, folder + file, r"^[^;\s]", rng)


@mutator(KUKA)
def line_a_comment(rng, texts, folder):
    return swap(texts, folder + "sps_user.sub", r"(?m)^(\$OUT|TANDEM_SEEN)", r";\1", rng)


@mutator(KUKA)
def seen_at_first(rng, texts, folder):
    pattern = "TANDEM_SEEN=FALSE"
    return swap(
        texts, folder + "config_user.dat", pattern, either(rng, "TANDEM_SEEN=TRUE", "TANDEM_SAW"), rng
    )


@mutator(KUKA)
def always_on(rng, texts, folder):
    line = either(rng, "$OUT[2]=TRUE", "$OUT[3]=TRUE", "$MOVE_ENABLE=TRUE")
    text = texts[folder + "sps_user.sub"]
    return {**texts, folder + "sps_user.sub": f"{text}{line}\r\n"}


@mutator(KUKA)
def krl_file_missing(rng, texts, folder):
    gone = folder + either(rng, "sps_user.sub", "config_user.dat")
    return {name: text for name, text in texts.items() if name != gone}


@mutator(KUKA)
def krl_file_left_over(rng, texts, folder):
    return {**texts, folder + either(rng, "EIO.cfg", "sps_2.sub"): texts[folder + "sps_user.sub"]}


def power_without_its_partner(rng, texts, folder):
    """Of powered controllers: the fourth term of the power is gone, or another one."""
    if folder + "EIO.cfg" in texts:
        pattern = r'\s*-Oper3 "AND"\s*\\?\s*-Act4 "\w+"'
        new = either(rng, "", ' -Oper3 "OR" -Act4 "diPartnerRunning"', ' -Oper3 "AND" -Act4 "diPartner"')
        return swap(texts, folder + "EIO.cfg", pattern, new, rng)
    new = either(rng, "", r" OR $IN[2]", r" AND $IN[1]", " AND NOT $IN[2]")
    return swap(texts, folder + "sps_user.sub", r"(?<=RDY) AND \$IN\[2\]", new, rng)

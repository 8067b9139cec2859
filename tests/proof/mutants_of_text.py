"""Faults of text, by kind: unreadable, undeclared or missing items.

Each mutator takes a random generator and the texts and returns changed texts. It never returns texts with the
same meaning.
"""

from __future__ import annotations

import re

from tests.languages.rapid.rapid_edits import change, edit, field, lines, moves, name, put, random_task
from tests.proof.registry import Table, into, pick

TEXT: Table = {}
mutator = into(TEXT)


@mutator("verify.syntax")
def no_semicolon(rng, texts):
    task = random_task(rng)
    rows = lines(texts, task)
    i = pick(rng, moves(texts, task))
    rows[i] = rows[i].rstrip(";")
    return put(texts, task, rows)


@mutator("verify.syntax")
def misspelt(rng, texts):
    task = random_task(rng)
    rows = lines(texts, task)
    i = pick(rng, moves(texts, task))
    rows[i] = rows[i].replace("MoveL", pick(rng, ["MovL", "Move", "MoveC"]))
    return put(texts, task, rows)


@mutator("verify.syntax")
def lost_end(rng, texts):
    file = name(pick(rng, ["Main", "Cut1", "Data"]), random_task(rng))
    return edit(texts, file, "ENDMODULE", "")


@mutator("verify.syntax")
def run_time_branch(rng, texts):
    task = random_task(rng)
    return edit(texts, name("Main", task), "cut_front;", "IF DOutput(doWirePower)=1 cut_front;")


@mutator("verify.declarations")
def undeclared(rng, texts):
    task = random_task(rng)
    k = int(rng.integers(len(moves(texts, task))))
    which = pick(rng, ["zone", "tool", "wobj", "speed"])
    return change(texts, task, k, **{which: field(texts, task, k, which) + "_x"})


@mutator("verify.declarations")
def lost_declaration(rng, texts):
    task = random_task(rng)
    rows = lines(texts, task, "Data")
    known = [
        i
        for i, row in enumerate(rows)
        if re.search(r"(CONST jointtarget|PERS wobj|PERS tool|VAR syncident)", row)
    ]
    rows.pop(pick(rng, known))
    return put(texts, task, rows, "Data")


@mutator("verify.pers_literal")
def pers_expression(rng, texts):
    task = random_task(rng)
    rows = lines(texts, task, "Data")
    i = next(i for i, row in enumerate(rows) if "PERS tooldata" in row)
    rows.insert(i, f"  PERS num extra:=1+{int(rng.integers(9))};")
    return put(texts, task, rows, "Data")


@mutator("verify.names")
def bad_name(rng, texts):
    task = random_task(rng)
    rows = lines(texts, task, "Data")
    i = next(i for i, row in enumerate(rows) if "PERS tooldata" in row)
    wrong = pick(rng, ["n" * 33, "while", "1st", "fine", "MoveL"])
    rows.insert(i, f"  CONST num {wrong}:=1;")
    return put(texts, task, rows, "Data")


@mutator("verify.names")
def double_name(rng, texts):
    task = random_task(rng)
    rows = lines(texts, task, "Data")
    known = [i for i, row in enumerate(rows) if "CONST" in row or "VAR" in row]
    i = pick(rng, known)
    rows.insert(i, rows[i])
    return put(texts, task, rows, "Data")


@mutator("verify.line_length")
def long_line(rng, texts):
    task = random_task(rng)
    rows = lines(texts, task)
    i = pick(rng, moves(texts, task))
    rows[i] += " ! " + "x" * 250
    return put(texts, task, rows)


@mutator("verify.module_size")
def huge(rng, texts):
    task = random_task(rng)
    rows = lines(texts, task)
    rows[1:1] = ["  ! " + "x" * 200] * 5200
    return put(texts, task, rows)


def numeral(rng, texts, new, parts=(0, 2)):
    """Texts with one number of a target rewritten by ``new``, a function of it as written; ``parts``: of its
    place."""
    task, k = random_task(rng), int(rng.integers(len(moves(texts, 1))))
    place = field(texts, task, k, "pos").split(",")
    i = pick(rng, parts)
    place[i] = new(place[i])
    return change(texts, task, k, pos=",".join(place))


@mutator("verify.names")
def number_of_another_base(rng, texts):
    new = pick(rng, ["0x{}", "0b{}", "0o{}", "0D{}", "{}h"])
    return numeral(rng, texts, lambda old: new.format(int(abs(float(old)))))


@mutator("verify.syntax")
def number_parted(rng, texts):
    new = pick(rng, ["{} 5", "{}+0.1", "1/({})", "({})*1.1", "{}!5", "{};", "{}-1E-9", "{} E2"])
    return numeral(rng, texts, new.format)


@mutator("verify.decimals")
def number_of_no_float(rng, texts):
    new = pick(rng, ["1E39", "-4E+38", "9" * 60, "1E999", "3.5E38", "{}E", "{}.5", "{}e+"])
    return numeral(rng, texts, lambda old: new.format(old.lstrip("-")))


@mutator("verify.speed_data")
def exponent_turned(rng, texts):
    """An exponent that has lost its sign, or got one."""
    return numeral(rng, texts, lambda old: f"{float(old):.6E}".replace("E+", "E-"), (0,))


@mutator("verify.decimals")
def not_a_unit(rng, texts):
    task, k = random_task(rng), int(rng.integers(len(moves(texts, 1))))
    factor = 1.0 + 10.0 ** rng.uniform(-4.9, -2)
    orient = [float(v) * factor for v in field(texts, task, k, "orient").split(",")]
    return change(texts, task, k, orient=",".join(f"{v:.8f}" for v in orient))


@mutator("verify.files")
def lost_file(rng, texts):
    gone = name(pick(rng, ["Main", "Cut1", "Data"]), random_task(rng))
    return {file: text for file, text in texts.items() if file != gone}


@mutator("verify.files")
def stray_file(rng, texts):
    return {**texts, f"other_{int(rng.integers(99))}.mod": "MODULE other\nENDMODULE\n"}


@mutator("verify.files")
def short_list(rng, texts):
    task = random_task(rng)
    file = f"T_ROB{task}/Tandem_{task}.pgf"
    rows = texts[file].split("\n")
    listed = [i for i, row in enumerate(rows) if "<Module>" in row]
    rows.pop(pick(rng, listed))
    return {**texts, file: "\n".join(rows)}


@mutator("verify.digest")
def other_problem(rng, texts):
    task = random_task(rng)
    rows = lines(texts, task, "Data")
    i = next(i for i, row in enumerate(rows) if "problem_digest" in row)
    rows[i] = rows[i].replace(pick(rng, ["ab12ab", "12ab12"]), "ffffff", 1)
    return put(texts, task, rows, "Data")

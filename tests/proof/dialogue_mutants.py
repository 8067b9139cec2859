"""Faults in the operator dialogue of programs, by kind, for RAPID and for KRL."""

from __future__ import annotations

import itertools
import re

from tests.proof.registry import Mutator, Texts, named, pick

RAPID: dict[str, Mutator] = {}
KRL: dict[str, Mutator] = {}
rapid, krl = named(RAPID), named(KRL)

LIES = (
    "Take the block out by hand",
    "Have a look at the cell?",
    "Power is off: hands may come near",
    "The wire is cold",
)
STATEMENT = re.compile(r"\s*(UIMsgBox|TPWrite|SetDO|WaitTime)\b")


def main_of(texts: Texts) -> str:
    """The main module of the task that speaks most."""
    found = [file for file in texts if re.search(r"TandemMain_\d+\.mod$", file)]
    return max(found, key=lambda file: texts[file].count("UIMsgBox"))


def statements(text: str) -> list[tuple[int, int]]:
    """First and last row of each statement that says, switches or waits on the straight way, but for power
    off at the start."""
    rows = text.split("\n")
    out, inside, moved = [], False, False
    for i, row in enumerate(rows):
        word = row.strip()
        inside = word.startswith("PROC") or (inside and word not in ("ERROR", "UNDO"))
        moved |= "UIMsgBox" in row
        if inside and moved and STATEMENT.match(row):
            end = next(j for j in range(i, len(rows)) if rows[j].rstrip().endswith(";"))
            out.append((i, end))
    return out


def chosen(rng, text: str, words: str = "UIMsgBox|TPWrite|SetDO|WaitTime") -> tuple[list[str], int, int]:
    rows = text.split("\n")
    first, last = pick(rng, [s for s in statements(text) if re.match(rf"\s*({words})\b", rows[s[0]])])
    return rows, first, last


def put(texts: Texts, file: str, rows: list[str]) -> Texts:
    return {**texts, file: "\n".join(rows)}


def _another_figure(rng, row: str) -> str:
    """A row with one digit changed, or a number ten times as large."""
    places = list(re.finditer(r"\d+(?:\.\d+)?", row.split('"', 1)[1]))
    start = row.index('"') + 1
    found = pick(rng, places)
    a, b = start + found.start(), start + found.end()
    number = row[a:b]
    if rng.random() < 0.3:
        new = number.replace(".", "") + "0" if "." in number else number + "0"
    else:
        at = pick(rng, [k for k, sign in enumerate(number) if sign.isdigit()])
        new = number[:at] + str((int(number[at]) + int(rng.integers(1, 9))) % 10) + number[at + 1 :]
    return row[:a] + new + row[b:]


@rapid
def figure_changed(rng, texts):
    file = main_of(texts)
    rows = texts[file].split("\n")
    own = [i for a, b in statements(texts[file]) for i in range(a, b + 1)]
    with_figures = [i for i in own if re.search(r'"[^"]*\d[^"]*"', rows[i].replace('"Tandem"', ""))]
    # figures of the motion are looked at later, by their own rule
    i = pick(rng, [i for i in with_figures if not re.search(r"Clamps|deg|spacers|apart", rows[i])])
    head, sign, rest = rows[i].partition('"Tandem",')
    rows[i] = head + sign + _another_figure(rng, rest) if sign else _another_figure(rng, rows[i])
    return put(texts, file, rows)


@rapid
def figure_written_otherwise(rng, texts):
    file = main_of(texts)
    old, new = pick(
        rng, [(a, b) for a, b in ((" 78 W", " 78.0 W"), ("0.4 mm", "0.40 mm"), ("493.2", "493.20"),
                                  ("500.0 mm", "500 mm"), ("0.4 mm", "4E-1 mm")) if a in texts[file]]
    )  # fmt: skip
    return {**texts, file: texts[file].replace(old, new, 1)}


OPPOSITES = (
    ("NO wire", "a wire"),
    ("clear", "blocked"),
    ("nobody", "somebody"),
    ("clamped", "loose"),
    ("fixed", "loose"),
    ("taut", "slack"),
    ("cold", "hot"),
    ("taken off", "left on"),
    ("locked", "open"),
    ("done as instructed", "left as it was"),
    ("in the slot", "on the table"),
)


@rapid
def opposite(rng, texts):
    file = main_of(texts)
    rows = texts[file].split("\n")
    own = [i for a, b in statements(texts[file]) for i in range(a, b + 1)]
    old, new, i = pick(rng, [(a, b, i) for a, b in OPPOSITES for i in own if a in rows[i]])
    rows[i] = rows[i].replace(old, new, 1)
    return put(texts, file, rows)


@rapid
def other_question(rng, texts):
    file = main_of(texts)
    rows, first, last = chosen(rng, texts[file], "UIMsgBox")
    rows[first : last + 1] = [f'    UIMsgBox\\Header:="Tandem","{pick(rng, LIES)}"\\Buttons:=btnOK;']
    return put(texts, file, rows)


@rapid
def other_case(rng, texts):
    file = main_of(texts)
    rows, first, _ = chosen(rng, texts[file], "TPWrite")
    rows[first] = re.sub(r'"[^"]*"', lambda m: m[0].upper(), rows[first])
    return put(texts, file, rows)


@rapid
def deleted(rng, texts):
    file = main_of(texts)
    rows, first, last = chosen(rng, texts[file])
    del rows[first : last + 1]
    return put(texts, file, rows)


@rapid
def doubled(rng, texts):
    file = main_of(texts)
    rows, first, last = chosen(rng, texts[file])
    rows[last + 1 : last + 1] = rows[first : last + 1]
    return put(texts, file, rows)


@rapid
def moved(rng, texts):
    """A statement at another place on the straight way, behind a statement or a call that it stood before."""
    file = main_of(texts)
    rows, first, last = chosen(rng, texts[file])
    own = rows[first : last + 1]
    places = [i for i in range(len(rows)) if re.match(r"\s*(\w+;$|MoveAbsJ|WaitTime|SetDO)", rows[i])]
    places = [i for i in places if "EXIT" not in rows[i] and not (first - 1 <= i <= last)]
    inside = {j for a, b in _operation_bodies(rows) for j in range(a, b)}
    at = pick(rng, [i for i in places if i in inside])
    kept = [row for i, row in enumerate(rows) if not first <= i <= last]
    at = at + 1 - (len(own) if at > last else 0)
    return put(texts, file, [*kept[:at], *own, *kept[at:]])


def _operation_bodies(rows: list[str]) -> list[tuple[int, int]]:
    """Bodies of operations, without their handlers."""
    heads = [i for i, row in enumerate(rows) if "PROC operation" in row and "END" not in row]
    return [(i + 1, next(j for j in range(i, len(rows)) if rows[j].strip() == "ERROR")) for i in heads]


@rapid
def box_closes_itself(rng, texts):
    file = main_of(texts)
    rows, _, last = chosen(rng, texts[file], "UIMsgBox")
    new = pick(rng, ["\\Buttons:=btnOK\\MaxTime:=1", "\\Buttons:=btnYesNo", "\\Buttons:=btnOKCancel"])
    rows[last] = rows[last].replace("\\Buttons:=btnOK", new)
    assert new in rows[last]
    return put(texts, file, rows)


@rapid
def header_lies(rng, texts):
    file = main_of(texts)
    rows, first, _ = chosen(rng, texts[file], "UIMsgBox")
    rows[first] = rows[first].replace('"Tandem"', f'"{pick(rng, LIES)}"', 1)
    return put(texts, file, rows)


@rapid
def wait_changed(rng, texts):
    file = main_of(texts)
    rows, first, _ = chosen(rng, texts[file], "WaitTime")
    rows[first] = f"    WaitTime {pick(rng, ['0', '0.01', '3600', '4.9', '10.1', '1'])};"
    return put(texts, file, rows)


@rapid
def extra_line(rng, texts):
    """A line, a box or a wait more, anywhere between moves, on either task."""
    file = pick(rng, sorted(f for f in texts if re.search(r"Tandem(Main|Cut1)_\d+\.mod$", f)))
    rows = texts[file].split("\n")
    inside = [i for i, row in enumerate(rows) if re.match(r"\s*(MoveAbsJ|MoveL|SetDO|WaitSyncTask)", row)]
    body = {j for a, b in _all_bodies(rows) for j in range(a, b)}
    i = pick(rng, [i for i in inside if i in body])
    lie = pick(rng, LIES)
    new = pick(
        rng,
        [
            f'    TPWrite "{lie}";',
            '    TPWrite "";',
            "    TPErase;",
            f'    UIMsgBox\\Header:="Tandem","{lie}"\\Buttons:=btnOK;',
            f'    ErrWrite\\W,"Tandem","{lie}";',
            "    WaitTime 5;",
            "    WaitTime 3600;",
        ],
    )
    rows.insert(i, new)
    return put(texts, file, rows)


def _all_bodies(rows: list[str]) -> list[tuple[int, int]]:
    heads = [i for i, row in enumerate(rows) if re.match(r"\s*PROC ", row)]
    return [(i + 1, next(j for j in range(i, len(rows)) if rows[j].strip() == "ERROR")) for i in heads]


@rapid
def erased(rng, texts):
    """The message is erased before the question appears."""
    file = main_of(texts)
    rows, _, last = chosen(rng, texts[file], "TPWrite")
    rows.insert(last + 1, "    TPErase;")
    return put(texts, file, rows)


@rapid
def number_behind(rng, texts):
    file = main_of(texts)
    rows, first, _ = chosen(rng, texts[file], "TPWrite")
    more = pick(rng, ["\\Num:=578", "\\Bool:=TRUE"])
    rows[first] = rows[first].rstrip(";") + f"{more};"
    return put(texts, file, rows)


@rapid
def from_a_constant(rng, texts):
    file = main_of(texts)
    rows, first, _ = chosen(rng, texts[file], "TPWrite")
    rows[first] = "    TPWrite note;"
    rows.insert(1, f'  {pick(rng, ["CONST", "PERS", "VAR"])} string note:="{pick(rng, LIES)}";')
    return put(texts, file, rows)


@rapid
def known_at_run_time(rng, texts):
    file = main_of(texts)
    rows, first, _ = chosen(rng, texts[file], "TPWrite")
    text = re.search(r'"[^"]*"', rows[first])[0]
    condition = pick(rng, ["IsSyncMoveOn()", "DOutput(doWirePower)=0"])
    rows[first] = f"    IF {condition} THEN\n    TPWrite {text};\n    ENDIF"
    return put(texts, file, rows)


@rapid
def key_for_a_box(rng, texts):
    """A function key in place of a box: any of five keys goes on."""
    file = main_of(texts)
    rows, first, last = chosen(rng, texts[file], "UIMsgBox")
    text = re.findall(r'"([^"]*)"', rows[first])[1]
    rows[first : last + 1] = [f'    TPReadFK key,"{text}","Yes","","","","No";']
    rows.insert(1, "  VAR num key;")
    return put(texts, file, rows)


@rapid
def handler_lies(rng, texts):
    file = pick(rng, sorted(f for f in texts if re.search(r"Tandem(Main|Cut1)_\d+\.mod$", f)))
    rows = texts[file].split("\n")
    heads = [i for i, row in enumerate(rows) if row.strip() == "ERROR"]
    i = pick(rng, heads)
    end = next(j for j in range(i, len(rows)) if rows[j].strip() == "EXIT;")
    said = [j for j in range(i, end) if "TPWrite" in rows[j]]
    j = pick(rng, said)
    way = int(rng.integers(5))
    if way == 0:
        rows.insert(j, f'    TPWrite "{pick(rng, LIES)}";')
    elif way == 1:
        rows[j] = f'    TPWrite "{pick(rng, LIES)}";'
    elif way == 2:
        rows.pop(j)
    elif way == 3:
        rows.insert(j, f'    UIMsgBox\\Header:="Tandem","{pick(rng, LIES)}"\\Buttons:=btnOK;')
    else:
        rows[said[0]] = rows[said[0]].replace("ERRNO", "0")
    return put(texts, file, rows)


@rapid
def signal_moved(rng, texts):
    """Power on before the question that it waits for, or off behind the last one."""
    file = main_of(texts)
    rows = texts[file].split("\n")
    own = statements(texts[file])
    pairs = [(s, t) for s, t in itertools.pairwise(own) if s[1] + 1 == t[0]]
    pairs = [p for p in pairs if ("SetDO" in rows[p[0][0]]) != ("SetDO" in rows[p[1][0]])]
    (a, b), (c, d) = pick(rng, pairs)
    rows[a : d + 1] = [*rows[c : d + 1], *rows[a : b + 1]]
    return put(texts, file, rows)


# ---- KRL ----


def source(texts: Texts) -> str:
    """The main program."""
    return next(file for file in texts if file.endswith("straight.src"))


def _lines(texts: Texts) -> list[str]:
    return texts[source(texts)].split("\r\n")


def _krl_put(texts: Texts, rows: list[str]) -> Texts:
    return {**texts, source(texts): "\r\n".join(rows)}


def _marked(rows: list[str], marks: str = "?*") -> list[int]:
    return [i for i, row in enumerate(rows) if len(row) > 1 and row[0] == ";" and row[1] in marks]


@krl
def krl_figure(rng, texts):
    rows = _lines(texts)
    i = pick(rng, [i for i in _marked(rows) if re.search(r"\d", rows[i]) and "spacers" not in rows[i]])
    rows[i] = rows[i][:3] + _another_figure(rng, '"' + rows[i][3:])[1:]
    return _krl_put(texts, rows)


@krl
def krl_opposite(rng, texts):
    rows = _lines(texts)
    old, new, i = pick(rng, [(a, b, i) for a, b in OPPOSITES for i in _marked(rows) if a in rows[i]])
    rows[i] = rows[i].replace(old, new, 1)
    return _krl_put(texts, rows)


@krl
def krl_deleted(rng, texts):
    rows = _lines(texts)
    i = pick(rng, [*_marked(rows), *(k for k, row in enumerate(rows) if row.startswith("WAIT SEC"))])
    if rows[i].startswith(";?") and rows[i + 1] == "HALT":
        del rows[i : i + 2]
    else:
        del rows[i]
    return _krl_put(texts, rows)


@krl
def krl_doubled(rng, texts):
    rows = _lines(texts)
    i = pick(rng, _marked(rows))
    own = rows[i : i + 2] if rows[i + 1] == "HALT" else rows[i : i + 1]
    rows[i:i] = own
    return _krl_put(texts, rows)


@krl
def krl_extra(rng, texts):
    """An additional message or question, in the main program or among moves."""
    file = pick(rng, sorted(f for f in texts if f.endswith(".src")))
    rows = texts[file].split("\r\n")
    places = [i for i, row in enumerate(rows) if re.match(r"(PTP|SLIN|LIN|\$OUT|WAIT SEC|\$TOOL)", row)]
    lie = pick(rng, LIES)
    news = [[f";* {lie}"], [f";? {lie}", "HALT"]]
    if file == source(texts):  # among moves a wait is a move of its own, for other rules to see
        news.append(["WAIT SEC 5"])
    i = pick(rng, places)
    rows[i:i] = pick(rng, news)
    return {**texts, file: "\r\n".join(rows)}


@krl
def krl_wait(rng, texts):
    rows = _lines(texts)
    i = pick(rng, [i for i, row in enumerate(rows) if row.startswith("WAIT SEC")])
    rows[i] = f"WAIT SEC {pick(rng, ['0', '0.01', '3600', '4.9', '1'])}"
    return _krl_put(texts, rows)


@krl
def krl_told_for_asked(rng, texts):
    """What is to be confirmed can only be read."""
    rows = _lines(texts)
    i = pick(rng, [i for i in _marked(rows, "?") if rows[i + 1] == "HALT"][1:])
    rows[i : i + 2] = [rows[i].replace(";?", ";*")]
    return _krl_put(texts, rows)


@krl
def krl_moved(rng, texts):
    """A question, a line or a wait at another place in the main program."""
    rows = _lines(texts)
    i = pick(rng, [k for k in _marked(rows) if k + 1 < len(rows)][1:])
    own = rows[i : i + 2] if rows[i + 1] == "HALT" else rows[i : i + 1]
    rest = rows[:i] + rows[i + len(own) :]
    calls = r"(PTP|straight_\d\(\)|\$OUT)"
    places = [k for k, row in enumerate(rest) if re.match(calls, row)]
    here = max((k for k in places if k < i), default=-1)  # behind it the line stands already
    at = pick(rng, [k for k in places if k != here]) + 1
    return _krl_put(texts, [*rest[:at], *own, *rest[at:]])

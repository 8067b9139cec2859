"""Program texts that no writer produces. Seeded.

Tokens of real programs are swapped, dropped, repeated, spliced and cut. Numbers and lines have absurd sizes,
nesting is deep, and bytes are odd.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import numpy as np

TOKEN = re.compile(r"\"[^\"\n]*\"|[A-Za-z_$#&][\w.]*|\d+(?:\.\d+)?|[ \t]+|\r?\n|[^\w\s]")
NUMBERS = (
    *("0", "-0", "-0.0000", ".5", "5.", "1.E3", "1E-05", "3.86E2", "1E39", "1E999", "-4E38", "9" * 400, "+7"),
    *("0x1F", "'B0101'", "'HFF'", "16#FF", "1_000", "\u0663", "NaN", "Infinity", "- 5", "211.8972+5.0"),
    *("1/0", "5 DIV 0", "1E38*1E38", "(1E38*1E38)-(1E38*1E38)", "1E-46", "2147483648", "1.0e", "0.0.0"),
)
ODD = (
    *(
        "\0",
        "\x0b",
        "\x0c",
        "\r",
        "\x1a",
        "\x1c",
        "\x7f",
        "\x85",
        "\xa0",
        "\xad",
        "\u2028",
        "\u202e",
        "\ufeff",
    ),
    *(
        "\ud800",
        "\xe4",
        "\u0416",
        "\U0001f916",
        "!",
        ";",
        '"',
        "\\",
        "%",
        "{",
        "}",
        "[",
        "]",
        "(",
        ")",
        "\t",
        "&",
    ),
)
RAPID_ROWS = (
    "WHILE TRUE DO ENDWHILE",
    'WHILE TRUE DO TPWrite "a"; ENDWHILE',
    "FOR i FROM 1 TO 100000 DO FOR k FROM 1 TO 100000 DO ENDFOR ENDFOR",
    "FOR i FROM 1 TO 1E38 STEP 1E-38 DO ENDFOR",
    "FOR i FROM 5 TO 1 STEP 0 DO main; ENDFOR",
    "main;",
    '%"main"%;',
    '%"TandemMain_1:" + "main"%;',
    "IF TRUE THEN main; ENDIF",
    "GOTO x;",
    "x: y := x;",
    "MoveL [[1+1,2,3],[1,0,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]]\\ID:=10,v5,fine,tool0;",
    "MoveL Offs(p,0,0,1),v10,fine,tool0;",
    "MoveAbsJ [[0,0,0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v5\\T:=1E30,fine,tool0;",
    "MoveAbsJ [[1E30,0,0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v5,fine,tool0;",
    "WaitTime 1E30;",
    "VAR num n:=n;",
    "CONST num a:=b; CONST num b:=a;",
    "CONST robtarget q{2}:=[[[0,0,0],[1,0,0,0],[0,0,0,0],[0,0,0,0,0,0]],[1]];",
    "IF [1,2]=[1,2] THEN Stop; ENDIF",
    "IF tool0=tool0 OR NOT wobj0=5 THEN Stop; ENDIF",
    "TPWrite " + "+".join(['"a"'] * 500) + ";",
    "x := " + "1+" * 3000 + "1;",
    "x := " + "(" * 300 + "1" + ")" * 300 + ";",
    "x := " + "[" * 300 + "1" + "]" * 300 + ";",
    "x := " + "-" * 300 + "1;",
    "IF a THEN " * 100 + "Stop; " + "ENDIF " * 100,
    "ERROR",
    "UNDO",
    "ENDPROC",
    "TRAP t",
    "PROC p(num a, \\switch b)",
    "FUNC num f()",
    "RECORD r num a; ENDRECORD",
)
KRL_ROWS = (
    "LOOP",
    "ENDLOOP",
    "WHILE TRUE",
    "FOR I=1 TO 100000",
    "ENDFOR",
    "GOTO X",
    "straight()",
    "straight_1()",
    "straight_2()",
    "PTP {X 1.0,Y 2.0,Z 3.0,A 0.0,B 0.0,C 0.0}",
    "SLIN {X 1E38,Y 2.0,Z 3.0,A 1E30,B 0.0,C 0.0}",
    "SLIN {X 1.0+1.0,Y 2.0,Z 3.0,A 0.0,B 0.0,C 0.0}",
    "SLIN {X 1.0,Y 2.0,Z {X 1},A 0.0,B 0.0,C 0.0}",
    "SLIN " + "{" * 90 + "}" * 90,
    "SLIN {" + "X 1.0," * 3000 + "}",
    "$VEL.CP=1E-30",
    "$VEL.CP=" + "1" * 150,
    "$OUT[0]=TRUE",
    "WAIT SEC 1E30",
    "WAIT SEC 0",
    "HALT",
    ";? sure",
    ";* told",
    "END",
    "DEF x()",
    "INTERRUPT ON 3",
    "GLOBAL INTERRUPT DECL 3 WHEN $STOPMESS==TRUE DO IR_STOPM ( )",
    "&COMMENT x",
    "DECL CHAR c[999]",
    "DECL E6AXIS x_home={A1 1E38,A2 0,A3 0,A4 0,A5 0,A6 0,E1 0,E2 0,E3 0,E4 0,E5 0,E6 0}",
)


def garble(rng: np.random.Generator, texts: Mapping[str, str], krl: bool = False) -> dict[str, str]:
    """The texts with one to four things done to one of the files."""
    out = dict(texts)
    for _ in range(int(rng.integers(1, 5))):
        file = _pick(rng, sorted(out))
        out[file] = _DEEDS[int(rng.integers(len(_DEEDS)))](rng, out[file], out, krl)
    return out


def _pick(rng, items: Sequence):
    return items[int(rng.integers(len(items)))]


def _tokens(rng, text):
    """Offsets of a few tokens near each other, so that what is garbled has something to do with itself."""
    at = int(rng.integers(max(len(text), 1)))
    begin = max(text.rfind("\n", 0, max(at - 200, 0)), 0)
    return [(begin + m.start(), begin + m.end()) for m in TOKEN.finditer(text[begin : at + 200])] or [(0, 0)]


def _swap(rng, text, texts, krl):
    spans = _tokens(rng, text)
    (a, b), (c, d) = sorted([_pick(rng, spans), _pick(rng, spans)])
    return text[:a] + text[c:d] + text[b:c] + text[a:b] + text[d:] if b <= c else text


def _drop(rng, text, texts, krl):
    a, b = _pick(rng, _tokens(rng, text))
    return text[:a] + text[b:]


def _repeat(rng, text, texts, krl):
    a, b = _pick(rng, _tokens(rng, text))
    return text[:b] + text[a:b] * int(_pick(rng, [1, 2, 50])) + text[b:]


def _other(rng, text, texts, krl):
    """Insert a token of another place or file."""
    a, b = _pick(rng, _tokens(rng, text))
    source = texts[_pick(rng, sorted(texts))]
    c, d = _pick(rng, _tokens(rng, source))
    return text[:a] + source[c:d] + text[b:]


def _number(rng, text, texts, krl):
    spans = [(a, b) for a, b in _tokens(rng, text) if text[a:b][:1].isdigit()]
    if not spans:
        return text
    a, b = _pick(rng, spans)
    return text[:a] + _pick(rng, NUMBERS) + text[b:]


def _odd(rng, text, texts, krl):
    at = int(rng.integers(len(text) + 1))
    return text[:at] + _pick(rng, ODD) * int(_pick(rng, [1, 1, 3])) + text[at:]


def _row(rng, text, texts, krl):
    """A line of the language that harms, at a line's end."""
    ends = [m.end() for m in re.finditer("\n", text)] or [0]
    at = _pick(rng, ends)
    return text[:at] + _pick(rng, KRL_ROWS if krl else RAPID_ROWS) + "\n" + text[at:]


def _move_rows(rng, text, texts, krl):
    rows = text.split("\n")
    i, j = sorted(int(rng.integers(len(rows))) for _ in range(2))
    k = int(rng.integers(len(rows)))
    return "\n".join([*rows[:k], *rows[i : min(j, i + 30)], *rows[k:]])


def _cut(rng, text, texts, krl):
    return text[: int(rng.integers(len(text) + 1))]


def _splice(rng, text, texts, krl):
    """The head of one file and the tail of another."""
    source = texts[_pick(rng, sorted(texts))]
    return text[: int(rng.integers(len(text) + 1))] + source[int(rng.integers(len(source) + 1)) :]


def _long(rng, text, texts, krl):
    at = int(rng.integers(len(text) + 1))
    return (
        text[:at]
        + _pick(rng, [" ", "x", "9", "[", "(", "1,", "-", "\t", '"', "!", ";", "\n"]) * 3000
        + text[at:]
    )


def _ends(rng, text, texts, krl):
    return text.replace("\r\n", "\n").replace("\n", _pick(rng, ["\r", "\r\n", "\n\r", "\n\n", "\x85", ""]))


_DEEDS = (
    *(_swap, _drop, _repeat, _other, _other, _number, _number, _number, _odd, _odd, _row, _row, _row),
    *(_move_rows, _cut, _splice, _long, _ends),
)

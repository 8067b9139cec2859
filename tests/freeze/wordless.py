"""What is left of a result file without its words: numbers, structure and statements.

A change of wording must not change anything else. Each kind of file has its own mask:

| file | what is compared |
|---|---|
| program, controller file | tokens without comments; letters of names become ``w``, texts ``s`` |
| JSON | values in their order; of texts and keys, the numbers |
| YAML, text, HTML | numbers in ascending order, since a sentence may state them in another order |
| NPZ | contents of the arrays in their order, without their names |

Digests (hex texts of eight or more characters) are left out everywhere: they follow from what is compared.
"""

import hashlib
import html
import io
import json
import re
import zipfile
from pathlib import PurePath
from typing import Any, Final

HEX: Final = re.compile(r"\b(?=[0-9a-f]*[a-f])(?=[0-9a-f]*[0-9])[0-9a-f]{8,}\b")
NUMBER: Final = re.compile(r"(?:(?<![0-9a-z])[-+])?\d+(?:\.\d+)?")
"""A number, also beside letters: of a unit, or in the path of a drawing. Behind a digit or a small letter, a
hyphen is no sign."""
BRACKETED: Final = re.compile(r"\([^)]*\)")
"""A comment of G-code."""
COMMENTS: Final = {
    ".mod": "!",
    ".sys": "!",
    ".src": ";",
    ".dat": ";",
    ".sub": ";",
    ".script": "#",
    ".nc": ";",
    ".cfg": "#",
    ".pgf": "#",
}
"""First character of a comment that ends with its line, by suffix of the program."""
TOKEN: Final = re.compile(
    r'(?P<text>"[^"\n]*")|(?P<word>[A-Za-z_$][\w$]*)|(?P<number>\d[\w.]*)|(?P<other>\S)'
)
LETTERS: Final = re.compile(r"[A-Za-z_$]+")
WORDED: Final = frozenset({*COMMENTS, ".json", ".npz", ".html", ".yaml", ".txt"})
"""Suffixes of files that contain words; NPZ files have names of arrays."""


def has_words(name: str) -> bool:
    """Return whether a file has a mask of its own."""
    return PurePath(name).suffix in WORDED


def digest(name: str, content: bytes) -> str:
    """Return the SHA-256 of what is left of a file without its words."""
    suffix = PurePath(name).suffix
    if suffix in COMMENTS:
        text = content.decode("utf-8")
        kept = _program(BRACKETED.sub("", text) if suffix == ".nc" else text, COMMENTS[suffix])
    elif suffix == ".json":
        kept = "\n".join(_values(json.loads(content)))
    elif suffix == ".npz":
        kept = _arrays(content)
    else:
        text = content.decode("utf-8")
        kept = "\n".join(sorted(numbers(html.unescape(text) if suffix == ".html" else text)))
    return hashlib.sha256(kept.encode()).hexdigest()


def numbers(text: str) -> list[str]:
    """Return the numbers of a text, without those of digests."""
    return NUMBER.findall(HEX.sub("", text))


def _program(text: str, comment: str) -> str:
    out = []
    for line in text.splitlines():
        kept = []
        for match in TOKEN.finditer(line):
            if match["other"] == comment:
                break
            kept.append("s" if match["text"] else LETTERS.sub("w", match[0]) if match["word"] else match[0])
        out.append(" ".join(kept))
    return "\n".join(line for line in out if line)


def _values(value: Any) -> list[str]:
    if isinstance(value, dict):
        return [
            "{",
            *(item for key, inner in value.items() for item in (*numbers(key), *_values(inner))),
            "}",
        ]
    if isinstance(value, list):
        return ["[", *(item for inner in value for item in _values(inner)), "]"]
    if isinstance(value, str):
        return ["s", *sorted(numbers(value))]
    return [repr(value)]


def _arrays(content: bytes) -> str:
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        return "\n".join(hashlib.sha256(archive.read(name)).hexdigest() for name in archive.namelist())

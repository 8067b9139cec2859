"""What people write into the service: bodies of JSON, and the texts in them, in any language.

Texts are kept as they are, normalised (NFC, Unicode Standard Annex 15). What has no place in them is refused
and named: control characters, and marks that are not seen and turn or hide what stands beside them (Unicode
Technical Report 36, 2.5); the two that join letters or keep them apart are needed in some scripts.
"""

import unicodedata
from typing import Annotated, Any, Final, TypeVar

from fastapi import Request
from pydantic import AfterValidator, BaseModel, Field, ValidationError
from pydantic_core import PydanticCustomError

from planner.issues import Issue
from planner.service.security import MB, RefusedError, too_large

LONGEST: Final = MB
"""Bytes of a body that says what to do."""
LINE: Final = 200
"""Characters of a text of one line."""
LINES: Final = 2000
"""Characters of a text of several lines."""
JOINERS: Final = "\u200c\u200d"
"""Marks that are not seen and are part of words."""
BLANK: Final = "\u115f\u1160\u2800\u3164\uffa0"
"""Letters and signs that are not seen: what is called by them cannot be told, or clicked."""
BESIDE: Final = ("Cf", "Mn", "Me", "Zs")
"""Kinds of characters that are seen beside others alone."""
REFUSED: Final = ("Cc", "Cf", "Co", "Cs", "Zl", "Zp")
"""Kinds of characters that are refused: control, format, private use, halves, separators of lines."""
Body = TypeVar("Body", bound=BaseModel)


def line(text: str, most: int = LINE) -> str:
    """A text of one line, as it is kept, of at most so many characters. Raises ``PydanticCustomError``."""
    return _kept(text, "", most)


def begin(text: str, most: int = LINE) -> str:
    """The begin of a text as :func:`line` keeps it, however long it is. Raises ``PydanticCustomError``."""
    return line(unicodedata.normalize("NFC", text)[:most], most)


def lines(text: str) -> str:
    """A text of several lines, as it is kept. Raises ``PydanticCustomError``."""
    return _kept(text.replace("\r\n", "\n"), "\n\t", LINES)


def _kept(text: str, allowed: str, most: int) -> str:
    kept = unicodedata.normalize("NFC", text).strip()
    if len(kept) > most:  # some letters become two or three
        what = "has {count} characters as it is kept (NFC), at most {most} may be; make it shorter"
        raise PydanticCustomError("text", what, {"count": len(kept), "most": most})
    for one in kept:
        if one not in JOINERS + allowed and (one in BLANK or unicodedata.category(one) in REFUSED):
            name = unicodedata.name(one, "a control character").lower()
            what = "has U+{code} ({name}), which is not seen or is no text; take it out"
            raise PydanticCustomError("text", what, {"code": f"{ord(one):04X}", "name": name})
    if kept and all(unicodedata.category(one) in BESIDE for one in kept):
        what = "has {count} characters, none of which is seen by itself; write a word"
        raise PydanticCustomError("text", what, {"count": len(kept)})
    return kept


Line = Annotated[str, Field(max_length=LINE), AfterValidator(line)]
"""A text of one line."""
Lines = Annotated[str, Field(max_length=LINES), AfterValidator(lines)]
"""A text of several lines."""


def described(model: type[BaseModel]) -> dict[str, Any]:
    """How the description of the interface tells of a body that :func:`read_body` reads."""
    schema = model.model_json_schema()
    return {"requestBody": {"required": True, "content": {"application/json": {"schema": schema}}}}


async def read_body(request: Request, model: type[Body]) -> Body:
    """The body of a request; raises :class:`RefusedError`, 413 or 422."""
    text = bytearray()
    async for chunk in request.stream():
        text += chunk
        if len(text) > LONGEST:
            raise too_large("the body", LONGEST / MB, "body")
    try:
        return model.model_validate_json(bytes(text) or b"{}")
    except ValidationError as error:
        issues = []
        for fault in error.errors():
            field = ".".join(str(step) for step in fault["loc"]) or "body"
            issues.append(Issue("service.request", f"{field}: {fault['msg']}; correct it", field=field))
        raise RefusedError(422, issues) from error

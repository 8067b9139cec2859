"""User texts: JSON bodies, and the texts in them, in any language.

Texts are stored unchanged except for normalisation (NFC, Unicode Standard Annex 15). Refused are control
characters, and invisible characters that reorder or hide adjacent text (Unicode Technical Report 36, 2.5).
The two joiners are allowed, because some scripts need them.
"""

import unicodedata
from typing import Annotated, Any, Final, TypeVar

from fastapi import Request
from pydantic import AfterValidator, BaseModel, Field, ValidationError
from pydantic_core import PydanticCustomError

from planner.issues import Issue
from planner.service.security import MB, RefusedError, too_large

MAX_BODY_BYTES: Final = MB
"""Maximum size [bytes] of a JSON body."""
MAX_LINE_LENGTH: Final = 200
"""Maximum number of characters of a single-line text."""
MAX_TEXT_LENGTH: Final = 2000
"""Maximum number of characters of a multi-line text."""
JOINING_CHARACTERS: Final = "\u200c\u200d"
"""Invisible characters that are parts of words."""
INVISIBLE_LETTERS: Final = "\u115f\u1160\u2800\u3164\uffa0"
"""Letters and symbols without a visible shape. A name of these could not be read or clicked."""
COMBINING_CATEGORIES: Final = ("Cf", "Mn", "Me", "Zs")
"""Unicode categories that are visible only next to other characters."""
REFUSED_CATEGORIES: Final = ("Cc", "Cf", "Co", "Cs", "Zl", "Zp")
"""Refused Unicode categories: control, format, private use, surrogates, line and paragraph separators."""
Body = TypeVar("Body", bound=BaseModel)


def normalised_line(text: str, max_length: int = MAX_LINE_LENGTH) -> str:
    """Normalise and check a single-line text.

    Args:
        text: Text.
        max_length: Maximum number of characters.

    Raises:
        PydanticCustomError: The text is too long or has forbidden characters.
    """
    return _normalise(text, "", max_length)


def truncated_line(text: str, max_length: int = MAX_LINE_LENGTH) -> str:
    """Return the beginning of a text, as :func:`normalised_line` normalises it.

    Args:
        text: Text of any length.
        max_length: Maximum number of characters.

    Raises:
        PydanticCustomError: The text has forbidden characters.
    """
    return normalised_line(unicodedata.normalize("NFC", text)[:max_length], max_length)


def normalised_text(text: str) -> str:
    """Normalise and check a multi-line text.

    Raises:
        PydanticCustomError: The text is too long or has forbidden characters.
    """
    return _normalise(text.replace("\r\n", "\n"), "\n\t", MAX_TEXT_LENGTH)


def _normalise(text: str, allowed: str, max_length: int) -> str:
    """Normalise a text (NFC) and check it.

    Args:
        text: Text.
        allowed: Control characters that are allowed.
        max_length: Maximum number of characters.

    Raises:
        PydanticCustomError: The text is too long, has forbidden characters, or nothing visible.
    """
    normalised = unicodedata.normalize("NFC", text).strip()
    if len(normalised) > max_length:  # normalisation may make a text longer
        message = "is too long after normalisation (NFC) (got {count} characters, allowed {most})"
        raise PydanticCustomError("text", message, {"count": len(normalised), "most": max_length})
    for character in normalised:
        if character not in JOINING_CHARACTERS + allowed and (
            character in INVISIBLE_LETTERS or unicodedata.category(character) in REFUSED_CATEGORIES
        ):
            name = unicodedata.name(character, "a control character").lower()
            message = "contains the forbidden character U+{code} ({name}), which is invisible or not text"
            raise PydanticCustomError("text", message, {"code": f"{ord(character):04X}", "name": name})
    if normalised and all(
        unicodedata.category(character) in COMBINING_CATEGORIES for character in normalised
    ):
        message = "has no visible character (got {count} characters)"
        raise PydanticCustomError("text", message, {"count": len(normalised)})
    return normalised


Line = Annotated[str, Field(max_length=MAX_LINE_LENGTH), AfterValidator(normalised_line)]
"""A single-line text."""
Lines = Annotated[str, Field(max_length=MAX_TEXT_LENGTH), AfterValidator(normalised_text)]
"""A multi-line text."""


def body_description(model: type[BaseModel]) -> dict[str, Any]:
    """Return the OpenAPI description of a body that :func:`read_body` reads."""
    schema = model.model_json_schema()
    return {"requestBody": {"required": True, "content": {"application/json": {"schema": schema}}}}


async def read_body(request: Request, model: type[Body]) -> Body:
    """Read and validate the JSON body of a request.

    Args:
        request: Request.
        model: Model of the body.

    Raises:
        RefusedError: 413 or 422.
    """
    text = bytearray()
    async for chunk in request.stream():
        text += chunk
        if len(text) > MAX_BODY_BYTES:
            raise too_large("the body", MAX_BODY_BYTES / MB, "body")
    try:
        return model.model_validate_json(bytes(text) or b"{}")
    except ValidationError as error:
        issues = []
        for error_entry in error.errors():
            field = ".".join(str(part) for part in error_entry["loc"]) or "body"
            issues.append(
                Issue("service.request", f"{field}: {error_entry['msg']}. Correct the value.", field=field)
            )
        raise RefusedError(422, issues) from error

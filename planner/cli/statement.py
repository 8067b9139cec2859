"""Signed statements: which files a result folder holds, for which problem, and what was proven.

``statement.json`` names every file of a result by its SHA-256, ``statement.json.sig`` signs it. A
signature says who stands for the result; that the programs are safe is proven from their text each
time.

Signatures are in the format of OpenSSH (SSHSIG, PROTOCOL.sshsig), by Ed25519 keys: what
``ssh-keygen -Y sign`` writes and ``ssh-keygen -Y verify`` reads. They need the package
``cryptography`` (extra ``sign``).
"""

from __future__ import annotations

import base64
import binascii
import dataclasses
import getpass
import hashlib
import json
import struct
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from planner.files import RESULT, SIGNATURE, STATEMENT, versions, write_whole
from planner.issues import Issue, Severity, TandemError, refusal

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

    from planner.problem import Problem
    from planner.proof.verdict import Proof

SIGN_INSTALL: Final = "pip install 'tandem-planner[sign]'"
"""What installs the extra that signing needs."""
NAMESPACE: Final = "tandem"
"""What signatures are for; a signature for another purpose is none of ours."""
KEY_KIND: Final = "ssh-ed25519"
"""The kind of keys, as OpenSSH calls it."""
HASH: Final = "sha512"
"""The hash that signatures are made over."""
BEGIN: Final = "-----BEGIN SSH SIGNATURE-----"
"""First line of an armoured signature."""
END: Final = "-----END SSH SIGNATURE-----"
"""Last line of an armoured signature."""
LINE_WIDTH: Final = 70
"""Characters of a line of an armoured signature."""
_MAGIC: Final = b"SSHSIG"
"""How signatures, and what they are made over, begin (PROTOCOL.sshsig of OpenSSH)."""
_MAX_KEY_FILE_BYTES: Final = 100_000
"""Bytes that a file of keys may have."""


@dataclasses.dataclass(frozen=True)
class PublicKey:
    """A key that may have signed: ``raw`` (32 bytes), ``who`` it is by its file."""

    raw: bytes
    who: str = ""

    @property
    def blob(self) -> bytes:
        """The key as OpenSSH has it."""
        return _string(KEY_KIND.encode()) + _string(self.raw)

    @property
    def fingerprint(self) -> str:
        """As ``ssh-keygen -l`` shows it."""
        digest = hashlib.sha256(self.blob).digest()
        return f"SHA256:{base64.b64encode(digest).decode().rstrip('=')}"


@dataclasses.dataclass(frozen=True)
class PrivateKey:
    """A key that signs."""

    key: Ed25519PrivateKey

    @property
    def public(self) -> PublicKey:
        """Its other half."""
        from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat

        return PublicKey(self.key.public_key().public_bytes(Encoding.Raw, PublicFormat.Raw))


def read_private_key(path: Path) -> PrivateKey:
    """The Ed25519 key in an OpenSSH file; asks for its passphrase at a terminal. Raises ``TandemError`` with
    ``sign.key`` or ``sign.extra``."""
    _require_cryptography()
    from cryptography.exceptions import UnsupportedAlgorithm
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
    from cryptography.hazmat.primitives.serialization import load_ssh_private_key

    data = _read(path)
    try:
        try:
            key = load_ssh_private_key(data, None)
        except TypeError:  # it has a passphrase
            if not sys.stdin.isatty():
                why = "it has a passphrase, and there is no terminal to ask for it: sign at one"
                raise ValueError(why) from None
            key = load_ssh_private_key(data, getpass.getpass(f"Passphrase of {path}: ").encode())
    except (ValueError, UnsupportedAlgorithm) as error:
        raise _bad_key(path, f"cannot be used: {error}") from error
    if not isinstance(key, Ed25519PrivateKey):
        raise _bad_key(path, "is no Ed25519 key")
    return PrivateKey(key)


def read_public_keys(path: Path) -> tuple[PublicKey, ...]:
    """The Ed25519 keys of a public key's file, or of a file of allowed signers. Raises ``TandemError`` with
    ``sign.key``: also for conditions on keys, other than a namespace, which are not looked at here."""
    out, elsewhere = [], ""
    for number, line in enumerate(_read(path).decode("utf-8", "replace").splitlines(), 1):
        words = line.split()
        if not words or words[0].startswith("#") or KEY_KIND not in words:
            continue
        at = words.index(KEY_KIND)
        who, options = (words[0], words[1:at]) if at else (" ".join(words[2:]), [])
        spaces = [word for word in options if word.lower().startswith("namespaces=")]
        if len(spaces) < len(options):
            what = f"line {number}: '{options[0]}' is not looked at here; check with ssh-keygen -Y verify"
            raise _bad_key(path, what)
        if spaces and NAMESPACE not in spaces[0].split("=", 1)[1].strip('"').split(","):
            elsewhere = f"; line {number} is for {spaces[0]}: add {NAMESPACE} to these where it may sign here"
            continue
        try:
            kind, raw, *rest = _strings(base64.b64decode(words[at + 1], validate=True))
        except (IndexError, ValueError, struct.error) as error:
            raise _bad_key(path, f"line {number} holds no key ({error})") from error
        if kind != KEY_KIND.encode() or len(raw) != 32 or rest:
            raise _bad_key(path, f"line {number} holds no Ed25519 key")
        out.append(PublicKey(raw, who))
    if not out:
        raise _bad_key(path, f"holds no {KEY_KIND} key for the namespace {NAMESPACE}{elsewhere}")
    return tuple(out)


def sign_message(message: bytes, key: PrivateKey) -> str:
    """The signature of a message, armoured."""
    signature = key.key.sign(_signed_bytes(message, HASH))
    parts = (key.public.blob, NAMESPACE.encode(), b"", HASH.encode())
    blob = _MAGIC + struct.pack(">I", 1) + b"".join(map(_string, parts))
    blob += _string(_string(KEY_KIND.encode()) + _string(signature))
    text = base64.b64encode(blob).decode()
    lines = [text[i : i + LINE_WIDTH] for i in range(0, len(text), LINE_WIDTH)]
    return "\n".join([BEGIN, *lines, END, ""])


def find_signer(message: bytes, armoured: str, known: Iterable[PublicKey]) -> PublicKey:
    """The key among those ``known`` that signed the message. Raises ``ValueError`` that says why none did,
    and ``TandemError`` with ``sign.extra``."""
    _require_cryptography()
    from cryptography.exceptions import InvalidSignature
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

    blob, namespace, hashed, kind, signature = _parsed(armoured)
    if namespace != NAMESPACE.encode():
        raise ValueError(f"it is a signature for {namespace.decode('ascii', 'replace')!r}, not {NAMESPACE!r}")
    if hashed not in (b"sha512", b"sha256") or kind != KEY_KIND.encode() or len(signature) != 64:
        raise ValueError("it is not by an Ed25519 key over SHA-512 or SHA-256")
    own = next((key for key in known if key.blob == blob), None)
    if own is None:
        by = f"SHA256:{base64.b64encode(hashlib.sha256(blob).digest()).decode().rstrip('=')}"
        raise ValueError(f"it is by the key {by}, which is none of those given")
    try:
        Ed25519PublicKey.from_public_bytes(own.raw).verify(signature, _signed_bytes(message, hashed.decode()))
    except InvalidSignature:
        raise ValueError("it does not belong to this text: the text was changed, or the signature") from None
    return own


def _parsed(armoured: str) -> tuple[bytes, bytes, bytes, bytes, bytes]:
    """Key, namespace, hash, kind and signature of an armoured signature. Raises ``ValueError``."""
    lines = [line.strip() for line in armoured.strip().splitlines()]
    if len(lines) < 3 or lines[0] != BEGIN or lines[-1] != END:
        raise ValueError("it is no SSH signature")
    try:
        blob = base64.b64decode("".join(lines[1:-1]), validate=True)
        if blob[:6] != _MAGIC or struct.unpack(">I", blob[6:10]) != (1,):
            raise ValueError("it is no SSH signature of version 1")
        key, namespace, _, hashed, inner = _strings(blob[10:])
        kind, signature = _strings(inner)
    except (binascii.Error, struct.error) as error:
        raise ValueError(f"it is damaged ({error})") from error
    return key, namespace, hashed, kind, signature


def _signed_bytes(message: bytes, hashed: str) -> bytes:
    parts = (NAMESPACE.encode(), b"", hashed.encode(), hashlib.new(hashed, message).digest())
    return _MAGIC + b"".join(map(_string, parts))


def _string(data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + data


def _strings(data: bytes) -> list[bytes]:
    """The strings that follow each other in some data. Raises ``ValueError``, ``struct.error``."""
    out = []
    while data:
        (size,) = struct.unpack(">I", data[:4])
        if len(data) < 4 + size:
            raise ValueError("it ends too early")
        out.append(data[4 : 4 + size])
        data = data[4 + size :]
    return out


def _require_cryptography() -> None:
    try:
        import cryptography  # noqa: F401
    except ImportError as error:
        what = f"signatures need the package cryptography: {SIGN_INSTALL}"
        raise refusal("sign.extra", what, hint=SIGN_INSTALL) from error


def _read(path: Path) -> bytes:
    try:
        data = path.read_bytes()
    except OSError as error:
        raise _bad_key(path, f"cannot be read ({error.strerror})") from error
    if len(data) > _MAX_KEY_FILE_BYTES:
        raise _bad_key(path, "is too large for a file of keys")
    return data


def _bad_key(path: Path, what: str) -> TandemError:
    hint = "make an Ed25519 key: ssh-keygen -t ed25519 -f KEY; sign with KEY, check with KEY.pub"
    return refusal("sign.key", f"key file {path} {what}", file=str(path), hint=hint)


FORMAT: Final = "tandem-statement"
"""What a statement says that it is."""
SCHEMA: Final = 1
"""Version of a statement's form."""
MOST_FILES_SHOWN: Final = 5
"""Files that differ from what was signed and are named; of more the number is told."""


def sign_result(folder: Path, problem: Problem, stored: str | None, proof: Proof, key: PrivateKey) -> str:
    """Write statement and signature of a result folder; the fingerprint of the key. Only what is proven for
    the problem that the folder carries, whose digest is ``stored``, is signed: raises ``TandemError`` with
    ``sign.unproven``."""
    if not proof.ok or stored != problem.digest:
        why = "the programs are not proven" if not proof.ok else "its copy of the problem is another one"
        what = f"{folder} is not signed, for {why}"
        raise refusal("sign.unproven", what, file=str(folder), hint="plan the problem again")
    content = text(folder, problem, proof)
    write_whole(folder / STATEMENT, content)
    write_whole(folder / SIGNATURE, sign_message(content, key))
    return key.public.fingerprint


def text(folder: Path, problem: Problem, proof: Proof) -> bytes:
    """The statement on a folder, as it is signed."""
    data = {
        "format": FORMAT,
        "schema": SCHEMA,
        "problem": {"name": problem.name, "digest": problem.digest},
        "proven": proof.ok,
        "rules": {rule.code: "holds" if rule.passed else "broken" for rule in proof.rules},
        "files": digests(folder),
        "versions": versions(),
    }
    return (json.dumps(data, indent=1, ensure_ascii=False) + "\n").encode()


def digests(folder: Path) -> dict[str, str]:
    """SHA-256 of each file of a result by its name in the folder, statement and signature left out."""
    out = {}
    for name in RESULT:
        top = folder / name
        inside = sorted(path for path in top.rglob("*") if path.is_file()) if top.is_dir() else [top]
        for path in inside:
            if name not in (STATEMENT, SIGNATURE) and path.is_file():
                digest = hashlib.sha256(path.read_bytes()).hexdigest()
                out[path.relative_to(folder).as_posix()] = digest
    return out


def check_signed(folder: Path, problem: Problem, signers: Path) -> tuple[Issue, ...]:
    """What is wrong with the signature of a result, by the keys in the file ``signers``; else a note
    (``sign.good``) that says who signed. Raises ``TandemError`` for keys that cannot be read."""
    known = read_public_keys(signers)
    try:
        content, armoured = (folder / STATEMENT).read_bytes(), (folder / SIGNATURE).read_text("ascii")
    except (OSError, UnicodeDecodeError) as error:
        what = f"{folder} is not signed: {STATEMENT} and {SIGNATURE} cannot be read ({error})"
        return (_issue("sign.missing", what, folder / SIGNATURE),)
    try:
        by = find_signer(content, armoured, known)
    except ValueError as error:
        return (_issue("sign.signature", f"the signature of {STATEMENT} does not hold: {error}", folder),)
    faults = _faults(folder, problem, content)
    if faults:
        more = f" and {len(faults) - MOST_FILES_SHOWN} more" if len(faults) > MOST_FILES_SHOWN else ""
        what = f"the folder is not what was signed: {'; '.join(faults[:MOST_FILES_SHOWN])}{more}"
        return (_issue("sign.content", what, folder / STATEMENT),)
    who = f" ({by.who})" if by.who else ""
    what = f"signed by {by.fingerprint}{who}: all files are as signed, for problem {problem.digest}"
    return (Issue("sign.good", what, Severity.NOTE, file=str(folder / SIGNATURE)),)


def _faults(folder: Path, problem: Problem, content: bytes) -> list[str]:
    """In what a folder and a problem differ from a signed statement."""
    try:
        data: dict[str, Any] = json.loads(content)
        if (data["format"], data["schema"]) != (FORMAT, SCHEMA):
            return [f"it is a statement of another format ({data['format']} {data['schema']})"]
        signed, stated, proven = dict(data["files"]), data["problem"]["digest"], data["proven"]
    except (ValueError, KeyError, TypeError) as error:
        return [f"the statement cannot be read ({type(error).__name__}: {error})"]
    out = [] if proven is True else ["the statement does not say that the programs are proven"]
    if stated != problem.digest:
        out.append(f"it was signed for problem {stated}, not {problem.digest}")
    found = digests(folder)
    for name in sorted({*found, *signed}):
        if name not in signed:
            out.append(f"{name} was added")
        elif name not in found:
            out.append(f"{name} is missing")
        elif found[name] != signed[name]:
            out.append(f"{name} was changed")
    return out


def _issue(code: str, what: str, path: Path) -> Issue:
    hint = "do not run the programs before you know why; ask whoever made them, or plan the problem yourself"
    return Issue(code, what, file=str(path), hint=hint)

"""Signed statements: the files of a result folder, their problem, and what was proven.

``statement.json`` names every file of a result by its SHA-256, and ``statement.json.sig`` signs it. A
signature states who vouches for the result. Whether the programs are safe is proven from their text each
time.

Signatures are in OpenSSH format (SSHSIG, PROTOCOL.sshsig), with Ed25519 keys: ``ssh-keygen -Y sign`` writes
them and ``ssh-keygen -Y verify`` reads them. They need the package ``cryptography`` (extra ``sign``).
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

from planner.files import RESULT_ENTRIES, SIGNATURE, STATEMENT, versions, write_atomic
from planner.issue_codes import format_message
from planner.issues import Issue, Severity, TandemError, issue_error

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

    from planner.problem import Problem
    from planner.proof.verdict import Proof

SIGN_INSTALL: Final = "pip install 'tandem-planner[sign]'"
"""Command that installs the extra for signing."""
NAMESPACE: Final = "tandem"
"""Purpose of signatures. A signature for another purpose is not accepted."""
KEY_KIND: Final = "ssh-ed25519"
"""Key type, in OpenSSH terms."""
HASH: Final = "sha512"
"""Hash over which signatures are made."""
ARMOUR_BEGIN: Final = "-----BEGIN SSH SIGNATURE-----"
"""First line of an armoured signature."""
ARMOUR_END: Final = "-----END SSH SIGNATURE-----"
"""Last line of an armoured signature."""
LINE_WIDTH: Final = 70
"""Characters per line of an armoured signature."""
_MAGIC: Final = b"SSHSIG"
"""Prefix of signatures and of signed data (PROTOCOL.sshsig of OpenSSH)."""
_MAX_KEY_FILE_BYTES: Final = 100_000
"""Maximum size [bytes] of a key file."""


@dataclasses.dataclass(frozen=True)
class PublicKey:
    """A key that may have signed.

    Attributes:
        raw: The key, 32 bytes.
        who: Its owner by the key file.
    """

    raw: bytes
    who: str = ""

    @property
    def blob(self) -> bytes:
        """The key in OpenSSH encoding."""
        return _pack_string(KEY_KIND.encode()) + _pack_string(self.raw)

    @property
    def fingerprint(self) -> str:
        """Fingerprint as shown by ``ssh-keygen -l``."""
        digest = hashlib.sha256(self.blob).digest()
        return f"SHA256:{base64.b64encode(digest).decode().rstrip('=')}"


@dataclasses.dataclass(frozen=True)
class PrivateKey:
    """A key that signs."""

    key: Ed25519PrivateKey

    @property
    def public(self) -> PublicKey:
        """Its public key."""
        from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat

        return PublicKey(self.key.public_key().public_bytes(Encoding.Raw, PublicFormat.Raw))


def read_private_key(path: Path) -> PrivateKey:
    """Read the Ed25519 key in an OpenSSH file; asks for its passphrase at a terminal.

    Raises:
        TandemError: ``sign.key`` or ``sign.extra``.
    """
    _require_cryptography()
    from cryptography.exceptions import UnsupportedAlgorithm
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
    from cryptography.hazmat.primitives.serialization import load_ssh_private_key

    data = _read_key_file(path)
    try:
        try:
            key = load_ssh_private_key(data, None)
        except TypeError:  # it has a passphrase
            if not sys.stdin.isatty():
                why = "it has a passphrase, and there is no terminal to ask for it: sign in a terminal"
                raise ValueError(why) from None
            key = load_ssh_private_key(data, getpass.getpass(f"Passphrase of {path}: ").encode())
    except (ValueError, UnsupportedAlgorithm) as error:
        raise _key_error(path, f"cannot be used: {error}") from error
    if not isinstance(key, Ed25519PrivateKey):
        raise _key_error(path, "is not an Ed25519 key")
    return PrivateKey(key)


def read_public_keys(path: Path) -> tuple[PublicKey, ...]:
    """Read the Ed25519 keys in a public key file or a file of allowed signers.

    Raises:
        TandemError: ``sign.key``, also for conditions on keys other than a namespace, which are not supported
            here.
    """
    out, elsewhere = [], ""
    for number, line in enumerate(_read_key_file(path).decode("utf-8", "replace").splitlines(), 1):
        words = line.split()
        if not words or words[0].startswith("#") or KEY_KIND not in words:
            continue
        at = words.index(KEY_KIND)
        who, options = (words[0], words[1:at]) if at else (" ".join(words[2:]), [])
        spaces = [word for word in options if word.lower().startswith("namespaces=")]
        if len(spaces) < len(options):
            what = f"line {number}: option '{options[0]}' is not supported; check with ssh-keygen -Y verify"
            raise _key_error(path, what)
        if spaces and NAMESPACE not in spaces[0].split("=", 1)[1].strip('"').split(","):
            elsewhere = f"; line {number} is for {spaces[0]}: add {NAMESPACE} to these if it may sign here"
            continue
        try:
            kind, raw, *rest = _unpack_strings(base64.b64decode(words[at + 1], validate=True))
        except (IndexError, ValueError, struct.error) as error:
            raise _key_error(path, f"line {number} contains no key ({error})") from error
        if kind != KEY_KIND.encode() or len(raw) != 32 or rest:
            raise _key_error(path, f"line {number} contains no Ed25519 key")
        out.append(PublicKey(raw, who))
    if not out:
        raise _key_error(path, f"contains no {KEY_KIND} key for the namespace {NAMESPACE}{elsewhere}")
    return tuple(out)


def sign_message(message: bytes, key: PrivateKey) -> str:
    """Sign a message; returns the armoured signature."""
    signature = key.key.sign(_signed_bytes(message, HASH))
    parts = (key.public.blob, NAMESPACE.encode(), b"", HASH.encode())
    blob = _MAGIC + struct.pack(">I", 1) + b"".join(map(_pack_string, parts))
    blob += _pack_string(_pack_string(KEY_KIND.encode()) + _pack_string(signature))
    text = base64.b64encode(blob).decode()
    lines = [text[i : i + LINE_WIDTH] for i in range(0, len(text), LINE_WIDTH)]
    return "\n".join([ARMOUR_BEGIN, *lines, ARMOUR_END, ""])


def find_signer(message: bytes, armoured: str, known: Iterable[PublicKey]) -> PublicKey:
    """Find the key that signed a message.

    Args:
        message: Signed data.
        armoured: Signature.
        known: Candidate keys.

    Raises:
        ValueError: None of the keys signed it; the text says why.
        TandemError: ``sign.extra``.
    """
    _require_cryptography()
    from cryptography.exceptions import InvalidSignature
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

    blob, namespace, hash_name, kind, signature = _parse_signature(armoured)
    if namespace != NAMESPACE.encode():
        raise ValueError(f"it is a signature for {namespace.decode('ascii', 'replace')!r}, not {NAMESPACE!r}")
    if hash_name not in (b"sha512", b"sha256") or kind != KEY_KIND.encode() or len(signature) != 64:
        raise ValueError("it is not by an Ed25519 key over SHA-512 or SHA-256")
    signer = next((key for key in known if key.blob == blob), None)
    if signer is None:
        by = f"SHA256:{base64.b64encode(hashlib.sha256(blob).digest()).decode().rstrip('=')}"
        raise ValueError(f"it is by the key {by}, which is not one of the stated keys")
    try:
        Ed25519PublicKey.from_public_bytes(signer.raw).verify(
            signature, _signed_bytes(message, hash_name.decode())
        )
    except InvalidSignature:
        raise ValueError("it does not match this text: the text or the signature was changed") from None
    return signer


def _parse_signature(armoured: str) -> tuple[bytes, bytes, bytes, bytes, bytes]:
    """Key, namespace, hash, key type and signature of an armoured signature. Raises ``ValueError``."""
    lines = [line.strip() for line in armoured.strip().splitlines()]
    if len(lines) < 3 or lines[0] != ARMOUR_BEGIN or lines[-1] != ARMOUR_END:
        raise ValueError("it is not an SSH signature")
    try:
        blob = base64.b64decode("".join(lines[1:-1]), validate=True)
        if blob[:6] != _MAGIC or struct.unpack(">I", blob[6:10]) != (1,):
            raise ValueError("it is not an SSH signature of version 1")
        key, namespace, _, hashed, inner = _unpack_strings(blob[10:])
        kind, signature = _unpack_strings(inner)
    except (binascii.Error, struct.error) as error:
        raise ValueError(f"it is damaged ({error})") from error
    return key, namespace, hashed, kind, signature


def _signed_bytes(message: bytes, hashed: str) -> bytes:
    parts = (NAMESPACE.encode(), b"", hashed.encode(), hashlib.new(hashed, message).digest())
    return _MAGIC + b"".join(map(_pack_string, parts))


def _pack_string(data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + data


def _unpack_strings(data: bytes) -> list[bytes]:
    """The length-prefixed strings in some data. Raises ``ValueError``, ``struct.error``."""
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
        what = format_message("sign.extra", install_command=SIGN_INSTALL)
        raise issue_error("sign.extra", what, hint=SIGN_INSTALL) from error


def _read_key_file(path: Path) -> bytes:
    try:
        data = path.read_bytes()
    except OSError as error:
        raise _key_error(path, f"cannot be read ({error.strerror})") from error
    if len(data) > _MAX_KEY_FILE_BYTES:
        raise _key_error(path, "is too large for a file of keys")
    return data


def _key_error(path: Path, what: str) -> TandemError:
    hint = "make an Ed25519 key: ssh-keygen -t ed25519 -f KEY; sign with KEY, check with KEY.pub"
    message = format_message("sign.key", path=path, fault=what)
    return issue_error("sign.key", message, file=str(path), hint=hint)


FORMAT: Final = "tandem-statement"
"""Format name in a statement."""
SCHEMA: Final = 1
"""Version of the statement format."""
MAX_FILES_SHOWN: Final = 5
"""Maximum number of differing files that are named. Further ones are counted."""


def sign_result(
    folder: Path, problem: Problem, stored_digest: str | None, proof: Proof, key: PrivateKey
) -> str:
    """Write statement and signature of a result folder.

    Only what is proven for the problem in the folder is signed.

    Args:
        folder: Result folder.
        problem: Problem of the proof.
        stored_digest: Digest of the problem in the folder.
        proof: Proof of the programs.
        key: Signing key.

    Returns:
        Fingerprint of the key.

    Raises:
        TandemError: ``sign.unproven``.
    """
    if not proof.ok or stored_digest != problem.digest:
        why = "the programs are not proven" if not proof.ok else "its copy of the problem differs"
        what = format_message("sign.unproven", folder=folder, reason=why)
        raise issue_error("sign.unproven", what, file=str(folder), hint="plan the problem again")
    content = text(folder, problem, proof)
    write_atomic(folder / STATEMENT, content)
    write_atomic(folder / SIGNATURE, sign_message(content, key))
    return key.public.fingerprint


def text(folder: Path, problem: Problem, proof: Proof) -> bytes:
    """The statement on a folder, as signed."""
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
    """SHA-256 of each file of a result by its name in the folder, without statement and signature."""
    out = {}
    for name in RESULT_ENTRIES:
        top = folder / name
        inside = sorted(path for path in top.rglob("*") if path.is_file()) if top.is_dir() else [top]
        for path in inside:
            if name not in (STATEMENT, SIGNATURE) and path.is_file():
                digest = hashlib.sha256(path.read_bytes()).hexdigest()
                out[path.relative_to(folder).as_posix()] = digest
    return out


def check_signed(folder: Path, problem: Problem, signers: Path) -> tuple[Issue, ...]:
    """Check the signature of a result against the keys in the file ``signers``.

    Returns:
        Issues with the signature; else a note (``sign.good``) with the signer.

    Raises:
        TandemError: The keys cannot be read.
    """
    known = read_public_keys(signers)
    try:
        content, armoured = (folder / STATEMENT).read_bytes(), (folder / SIGNATURE).read_text("ascii")
    except (OSError, UnicodeDecodeError) as error:
        what = f"{folder} is not signed: {STATEMENT} and {SIGNATURE} cannot be read ({error})"
        return (_signature_issue("sign.missing", what, folder / SIGNATURE),)
    try:
        by = find_signer(content, armoured, known)
    except ValueError as error:
        return (
            _signature_issue("sign.signature", f"the signature of {STATEMENT} is not valid: {error}", folder),
        )
    faults = _statement_differences(folder, problem, content)
    if faults:
        more = f" and {len(faults) - MAX_FILES_SHOWN} more" if len(faults) > MAX_FILES_SHOWN else ""
        what = f"the folder differs from what was signed: {'; '.join(faults[:MAX_FILES_SHOWN])}{more}"
        return (_signature_issue("sign.content", what, folder / STATEMENT),)
    who = f" ({by.who})" if by.who else ""
    what = f"signed by {by.fingerprint}{who}: all files are as signed, for problem {problem.digest}"
    return (Issue("sign.good", what, Severity.NOTE, file=str(folder / SIGNATURE)),)


def _statement_differences(folder: Path, problem: Problem, content: bytes) -> list[str]:
    """Differences of a folder and a problem from a signed statement."""
    try:
        data: dict[str, Any] = json.loads(content)
        if (data["format"], data["schema"]) != (FORMAT, SCHEMA):
            return [f"the statement has another format ({data['format']} {data['schema']})"]
        signed, stated, proven = dict(data["files"]), data["problem"]["digest"], data["proven"]
    except (ValueError, KeyError, TypeError) as error:
        return [f"the statement cannot be read ({type(error).__name__}: {error})"]
    out = [] if proven is True else ["the statement does not say that the programs are proven"]
    if stated != problem.digest:
        out.append(f"it was signed for problem {stated}, not {problem.digest}")
    current_digests = digests(folder)
    for name in sorted({*current_digests, *signed}):
        if name not in signed:
            out.append(f"{name} was added")
        elif name not in current_digests:
            out.append(f"{name} is missing")
        elif current_digests[name] != signed[name]:
            out.append(f"{name} was changed")
    return out


def _signature_issue(code: str, what: str, path: Path) -> Issue:
    hint = "do not run the programs before you know why; ask who created them, or plan the problem yourself"
    return Issue(code, what, file=str(path), hint=hint)

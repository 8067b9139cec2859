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
    """An Ed25519 key that verifies signatures.

    Attributes:
        raw: The key, 32 bytes.
        who: Name of its owner in the key file; empty if unknown.
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
    """An Ed25519 key that creates signatures."""

    key: Ed25519PrivateKey

    @property
    def public(self) -> PublicKey:
        """Its public key."""
        from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat

        return PublicKey(self.key.public_key().public_bytes(Encoding.Raw, PublicFormat.Raw))


def read_private_key(path: Path) -> PrivateKey:
    """Read the Ed25519 key in an OpenSSH file. Ask for its passphrase at the terminal if it has one.

    Raises:
        TandemError: ``sign.key``, the key cannot be used, or ``sign.extra``, the extra is not installed.
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
                reason = "it has a passphrase, and there is no terminal to ask for it: sign in a terminal"
                raise ValueError(reason) from None
            key = load_ssh_private_key(data, getpass.getpass(f"Passphrase of {path}: ").encode())
    except (ValueError, UnsupportedAlgorithm) as error:
        raise _key_error(path, f"cannot be used: {error}") from error
    if not isinstance(key, Ed25519PrivateKey):
        raise _key_error(path, "is not an Ed25519 key")
    return PrivateKey(key)


def read_public_keys(path: Path) -> tuple[PublicKey, ...]:
    """Read the Ed25519 keys in a public key file or a file of allowed signers.

    Lines with keys of other types or for other namespaces are skipped.

    Raises:
        TandemError: ``sign.key``, the file contains no usable key, or a key with an option other than
            ``namespaces``. Such conditions are not supported.
    """
    keys, namespace_hint = [], ""
    for number, line in enumerate(_read_key_file(path).decode("utf-8", "replace").splitlines(), 1):
        # "NAME OPTIONS ssh-ed25519 KEY" in a file of allowed signers, "ssh-ed25519 KEY NAME" in a public key.
        words = line.split()
        if not words or words[0].startswith("#") or KEY_KIND not in words:
            continue
        kind_index = words.index(KEY_KIND)
        who, options = (words[0], words[1:kind_index]) if kind_index else (" ".join(words[2:]), [])
        namespace_options = [word for word in options if word.lower().startswith("namespaces=")]
        if len(namespace_options) < len(options):
            fault = f"line {number}: option '{options[0]}' is not supported; check with ssh-keygen -Y verify"
            raise _key_error(path, fault)
        if namespace_options and NAMESPACE not in namespace_options[0].split("=", 1)[1].strip('"').split(","):
            namespace_hint = (
                f"; line {number} is for {namespace_options[0]}: add {NAMESPACE} to these if it may sign here"
            )
            continue
        try:
            kind, raw, *rest = _unpack_strings(base64.b64decode(words[kind_index + 1], validate=True))
        except (IndexError, ValueError, struct.error) as error:
            raise _key_error(path, f"line {number} contains no key ({error})") from error
        if kind != KEY_KIND.encode() or len(raw) != 32 or rest:
            raise _key_error(path, f"line {number} contains no Ed25519 key")
        keys.append(PublicKey(raw, who))
    if not keys:
        raise _key_error(path, f"contains no {KEY_KIND} key for the namespace {NAMESPACE}{namespace_hint}")
    return tuple(keys)


def sign_message(message: bytes, key: PrivateKey) -> str:
    """Sign a message. Return the armoured signature (PROTOCOL.sshsig, version 1)."""
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
        ValueError: None of the keys signed it. The text of the error gives the reason.
        TandemError: ``sign.extra``, the extra is not installed.
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
        fingerprint = f"SHA256:{base64.b64encode(hashlib.sha256(blob).digest()).decode().rstrip('=')}"
        raise ValueError(f"it is by the key {fingerprint}, which is not one of the stated keys")
    try:
        Ed25519PublicKey.from_public_bytes(signer.raw).verify(
            signature, _signed_bytes(message, hash_name.decode())
        )
    except InvalidSignature:
        raise ValueError("it does not match this text: the text or the signature was changed") from None
    return signer


def _parse_signature(armoured: str) -> tuple[bytes, bytes, bytes, bytes, bytes]:
    """Parse an armoured signature.

    Returns:
        Public key in OpenSSH encoding, namespace, name of the hash, key type, and the raw signature.

    Raises:
        ValueError: The text is not a signature, or it is damaged.
    """
    lines = [line.strip() for line in armoured.strip().splitlines()]
    if len(lines) < 3 or lines[0] != ARMOUR_BEGIN or lines[-1] != ARMOUR_END:
        raise ValueError("it is not an SSH signature")
    try:
        blob = base64.b64decode("".join(lines[1:-1]), validate=True)
        if blob[:6] != _MAGIC or struct.unpack(">I", blob[6:10]) != (1,):
            raise ValueError("it is not an SSH signature of version 1")
        key, namespace, _, hash_name, signature_blob = _unpack_strings(blob[10:])
        kind, signature = _unpack_strings(signature_blob)
    except (binascii.Error, struct.error) as error:
        raise ValueError(f"it is damaged ({error})") from error
    return key, namespace, hash_name, kind, signature


def _signed_bytes(message: bytes, hash_name: str) -> bytes:
    """Return the bytes that are signed for a message: they contain the namespace and the message's hash."""
    parts = (NAMESPACE.encode(), b"", hash_name.encode(), hashlib.new(hash_name, message).digest())
    return _MAGIC + b"".join(map(_pack_string, parts))


def _pack_string(data: bytes) -> bytes:
    """Encode a string of OpenSSH: its length as four bytes, then the data."""
    return struct.pack(">I", len(data)) + data


def _unpack_strings(data: bytes) -> list[bytes]:
    """Decode successive strings of OpenSSH.

    Raises:
        ValueError: The data end within a string.
        struct.error: The data end within a length.
    """
    strings = []
    while data:
        (size,) = struct.unpack(">I", data[:4])
        if len(data) < 4 + size:
            raise ValueError("it ends too early")
        strings.append(data[4 : 4 + size])
        data = data[4 + size :]
    return strings


def _require_cryptography() -> None:
    try:
        import cryptography  # noqa: F401
    except ImportError as error:
        message = format_message("sign.extra", install_command=SIGN_INSTALL)
        raise issue_error("sign.extra", message, hint=SIGN_INSTALL) from error


def _read_key_file(path: Path) -> bytes:
    try:
        data = path.read_bytes()
    except OSError as error:
        raise _key_error(path, f"cannot be read ({error.strerror})") from error
    if len(data) > _MAX_KEY_FILE_BYTES:
        raise _key_error(path, "is too large for a file of keys")
    return data


def _key_error(path: Path, fault: str) -> TandemError:
    hint = "make an Ed25519 key: ssh-keygen -t ed25519 -f KEY; sign with KEY, check with KEY.pub"
    message = format_message("sign.key", path=path, fault=fault)
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

    A result is signed only if its programs are proven, for the problem that is in the folder.

    Args:
        folder: Result folder.
        problem: Problem of the proof.
        stored_digest: Digest of the problem in the folder, or None.
        proof: Proof of the programs.
        key: Signing key.

    Returns:
        Fingerprint of the key.

    Raises:
        TandemError: ``sign.unproven``, the programs are not proven, or the problem in the folder differs.
    """
    if not proof.ok or stored_digest != problem.digest:
        reason = "the programs are not proven" if not proof.ok else "its copy of the problem differs"
        message = format_message("sign.unproven", folder=folder, reason=reason)
        raise issue_error("sign.unproven", message, file=str(folder), hint="plan the problem again")
    content = text(folder, problem, proof)
    write_atomic(folder / STATEMENT, content)
    write_atomic(folder / SIGNATURE, sign_message(content, key))
    return key.public.fingerprint


def text(folder: Path, problem: Problem, proof: Proof) -> bytes:
    """Return the statement on a result folder as JSON, in the form that is signed."""
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
    """Return the SHA-256 of each file of a result by its name in the folder.

    Statement and signature are left out.
    """
    sha256_by_name = {}
    for name in RESULT_ENTRIES:
        entry = folder / name
        paths = sorted(path for path in entry.rglob("*") if path.is_file()) if entry.is_dir() else [entry]
        for path in paths:
            if name not in (STATEMENT, SIGNATURE) and path.is_file():
                digest = hashlib.sha256(path.read_bytes()).hexdigest()
                sha256_by_name[path.relative_to(folder).as_posix()] = digest
    return sha256_by_name


def check_signed(folder: Path, problem: Problem, signers: Path) -> tuple[Issue, ...]:
    """Check the signature of a result against the keys in the file ``signers``.

    Returns:
        An issue if the signature is missing or invalid, or if files differ. Otherwise a note (``sign.good``)
        with the signer.

    Raises:
        TandemError: The keys cannot be read.
    """
    public_keys = read_public_keys(signers)
    try:
        content, armoured = (folder / STATEMENT).read_bytes(), (folder / SIGNATURE).read_text("ascii")
    except (OSError, UnicodeDecodeError) as error:
        message = f"{folder} is not signed: {STATEMENT} and {SIGNATURE} cannot be read ({error})"
        return (_signature_issue("sign.missing", message, folder / SIGNATURE),)
    try:
        signer = find_signer(content, armoured, public_keys)
    except ValueError as error:
        return (
            _signature_issue("sign.signature", f"the signature of {STATEMENT} is not valid: {error}", folder),
        )
    differences = _statement_differences(folder, problem, content)
    if differences:
        more = f" and {len(differences) - MAX_FILES_SHOWN} more" if len(differences) > MAX_FILES_SHOWN else ""
        shown = "; ".join(differences[:MAX_FILES_SHOWN])
        message = f"the folder differs from what was signed: {shown}{more}"
        return (_signature_issue("sign.content", message, folder / STATEMENT),)
    signer_name = f" ({signer.who})" if signer.who else ""
    message = (
        f"signed by {signer.fingerprint}{signer_name}: all files are as signed, for problem {problem.digest}"
    )
    return (Issue("sign.good", message, Severity.NOTE, file=str(folder / SIGNATURE)),)


def _statement_differences(folder: Path, problem: Problem, content: bytes) -> list[str]:
    """List the differences of a folder and a problem from a signed statement, as clauses for a message.

    Args:
        folder: Result folder.
        problem: Problem that the statement must name.
        content: Signed statement.
    """
    try:
        data: dict[str, Any] = json.loads(content)
        if (data["format"], data["schema"]) != (FORMAT, SCHEMA):
            return [f"the statement has another format ({data['format']} {data['schema']})"]
        signed_digests, stated_digest, proven = dict(data["files"]), data["problem"]["digest"], data["proven"]
    except (ValueError, KeyError, TypeError) as error:
        return [f"the statement cannot be read ({type(error).__name__}: {error})"]
    differences = [] if proven is True else ["the statement does not say that the programs are proven"]
    if stated_digest != problem.digest:
        differences.append(f"it was signed for problem {stated_digest}, not {problem.digest}")
    current_digests = digests(folder)
    for name in sorted({*current_digests, *signed_digests}):
        if name not in signed_digests:
            differences.append(f"{name} was added")
        elif name not in current_digests:
            differences.append(f"{name} is missing")
        elif current_digests[name] != signed_digests[name]:
            differences.append(f"{name} was changed")
    return differences


def _signature_issue(code: str, message: str, path: Path) -> Issue:
    hint = "do not run the programs before you know why; ask who created them, or plan the problem yourself"
    return Issue(code, message, file=str(path), hint=hint)

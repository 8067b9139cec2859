"""A minimal FTP server with TLS (RFC 4217) for tests: one user, one folder, one certificate."""

from __future__ import annotations

import contextlib
import socket
import ssl
import threading
from pathlib import Path


class FtpsServer:
    """``data_certificate``: another certificate for data connections, such as that of a man in the middle."""

    def __init__(self, root: Path, certificate: Path, data_certificate: Path | None = None) -> None:
        self.root, self.commands = root, list[str]()
        self.contexts = []
        for pem in (certificate, data_certificate or certificate):
            context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
            context.load_cert_chain(pem)
            self.contexts.append(context)
        self.socket = socket.create_server(("127.0.0.1", 0))
        self.url = f"ftps://127.0.0.1:{self.socket.getsockname()[1]}/"
        threading.Thread(target=self._serve, daemon=True).start()

    def close(self) -> None:
        self.socket.close()

    def _serve(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                control, _ = self.socket.accept()
                threading.Thread(target=self._talk, args=(control,), daemon=True).start()

    def _talk(self, control: socket.socket) -> None:
        with contextlib.suppress(OSError):
            control.sendall(b"220 ready\r\n")
            stream, passive = control.makefile("rb"), socket.socket()
            while line := stream.readline():
                word, _, rest = line.decode().strip().partition(" ")
                self.commands.append(f"{word} {rest}".strip())
                path = self.root / rest.strip("/")
                if word == "AUTH":
                    control.sendall(b"234 go on\r\n")
                    control = self.contexts[0].wrap_socket(control, server_side=True)
                    stream = control.makefile("rb")
                elif word == "PASV":
                    passive = socket.create_server(("127.0.0.1", 0))
                    port = passive.getsockname()[1]
                    control.sendall(f"227 (127,0,0,1,{port // 256},{port % 256})\r\n".encode())
                elif word in ("STOR", "RETR", "MLSD"):
                    control.sendall(b"150 here\r\n")
                    self._data(word, path, passive)
                    control.sendall(b"226 done\r\n")
                elif word == "MKD":
                    path.mkdir()
                    control.sendall(f'257 "{rest}" made\r\n'.encode())
                elif word == "CWD":
                    control.sendall(b"250 there\r\n" if path.is_dir() else b"550 no such folder\r\n")
                elif word == "PWD":
                    control.sendall(b'257 "/" is here\r\n')
                else:
                    control.sendall(b"331 password\r\n" if word == "USER" else b"200 well\r\n")

    def _data(self, word: str, path: Path, passive: socket.socket) -> None:
        plain, _ = passive.accept()
        with self.contexts[1].wrap_socket(plain, server_side=True) as data:
            if word == "STOR":
                with path.open("wb") as out:
                    while part := data.recv(65536):
                        out.write(part)
            else:
                rows = (f"type={'dir' if p.is_dir() else 'file'}; {p.name}\r\n" for p in path.glob("*"))
                data.sendall("".join(rows).encode() if word == "MLSD" else path.read_bytes())
            data.unwrap()

"""ABB controllers over Robot Web Services: states, configuration and files.

Programs are never started, and neither program pointer nor mode is ever changed.

1.0 (IRC5, RobotWare 6; digest login): ABB, Application manual Robot Web Services, 3HAC050973-001 revision M,
pages at developercenter.robotstudio.com/api/rwsApi: fs_directory_get_page, fs_directory_create_page,
fs_file_get_page, fs_file_upload_page, cfg_get_instance_page, panel_opmode_get_page, rapid_execution_page,
rapid_tasks_page, rapid_modules_get_page, rapid_symbol_data_page, rwsystem_get_system (options too),
msh_domain_request_page. ``json=1`` requests JSON.

2.0 (OmniCore, RobotWare 7; basic login over TLS): 3HAC073675-001 revision L, at
developercenter.robotstudio.com/api/RWS, Swagger_Doc/RAPID_Service.yaml for RAPID. Actions are the last word
of the path, media types carry ``v=2.0``. For files, mastership (domain ``edit``) and configuration its pages
were not available. Those follow public clients such as rpiRobotics/abb_robot_client (RobotWare 7) and others
that report success with a virtual RobotWare 7. The code has not been tested on a controller.

Base frames are read from MOC, where ``base_frame_pos_x`` is in metres (Technical reference manual System
parameters; abb_librws of ros-industrial reads the same).
"""

import contextlib
import html
import json
from collections.abc import Iterable, Iterator
from typing import Any
from urllib.parse import parse_qsl, quote, urlencode, urljoin, urlsplit

from planner.issues import TandemError, issue_error
from planner.shopfloor.loading.http_link import Answer, Link

MAX_PAGES = 500
"""Maximum number of pages of one list. A longer list is refused."""


class Rws:
    """An ABB controller with RWS ``version`` 1 or 2.

    All requests raise ``TandemError`` (``upload.controller``, ``upload.login``) if they fail.
    """

    def __init__(self, link: Link, version: int) -> None:
        self.link = link
        self.version = version

    # ---- states ----

    @property
    def mode(self) -> str:
        """Operating mode: ``AUTO``, ``MANR``, ``MANF`` ..."""
        return self._value("/rw/panel/opmode", "opmode")

    @property
    def state(self) -> str:
        """Controller state: ``motoron``, ``motoroff``, ``guardstop`` ..."""
        path = "/rw/panel/ctrlstate" if self.version == 1 else "/rw/panel/ctrl-state"
        return self._value(path, "ctrlstate")

    @property
    def execution(self) -> str:
        """Execution state: ``running`` or ``stopped``."""
        return self._value("/rw/rapid/execution", "ctrlexecstate")

    @property
    def robotware(self) -> str:
        """Version of RobotWare."""
        return self._value("/rw/system", "rwversion")

    @property
    def options(self) -> tuple[str, ...]:
        """Names of the installed options."""
        path = "/rw/system/options"
        out = tuple(str(item["option"]) for item in self._items(path) if "option" in item)
        if not out:
            raise issue_error(
                "upload.controller", f"{path}: no option is reported, but each controller has some"
            )
        return out

    @property
    def tasks(self) -> tuple[str, ...]:
        """Names of the RAPID tasks."""
        return tuple(self._named("/rw/rapid/tasks", "rap-task"))

    def modules(self, task: str) -> tuple[str, ...]:
        """Return the names of the modules that are loaded in a task."""
        path_1, path_2 = f"/rw/rapid/modules?task={quote(task)}", f"/rw/rapid/tasks/{quote(task)}/modules"
        return tuple(self._named(path_1 if self.version == 1 else path_2, "rap-module-info"))

    @property
    def signals(self) -> dict[str, str]:
        """Types (DO, DI ...) of all signals, by name."""
        items = self._named("/rw/iosystem/signals", "ios-signal")
        return {name: str(item.get("type", "")) for name, item in items.items()}

    @property
    def robots(self) -> dict[str, dict[str, str]]:
        """Attributes of each instance of ROBOT in MOC.cfg, by the name of the instance."""
        out: dict[str, dict[str, str]] = {}
        path = "/rw/cfg/moc/ROBOT/instances"
        for item in self._items(path):
            if str(item.get("_type", "")).startswith("cfg-dt-instance") and "_title" in item:
                name = str(item["_title"])
                # a list may state the instances without their attributes
                out[name] = _attributes([item]) or _attributes(self._items(f"{path}/{quote(name)}"))
        return out

    def datum(self, task: str, module: str, name: str) -> str | None:
        """Return the current value of a RAPID datum as text; None if there is no datum of that name.

        The status is then 404, or 400 with a code of the controller.
        """
        symbol = f"RAPID/{quote(task)}/{quote(module)}/{quote(name)}"
        path = f"/rw/rapid/symbol/data/{symbol}" if self.version == 1 else f"/rw/rapid/symbol/{symbol}/data"
        answer = self._get(path)
        if answer.status in (400, 404):
            return None
        values = [item["value"] for item in _all(self._read(path, answer)) if "value" in item]
        return str(values[0]) if values else None

    def hold(self) -> None:
        """Take mastership of RAPID, so that nobody else changes it meanwhile.

        Raises:
            TandemError: ``upload.busy`` if another client holds it.
        """
        path_1, path_2 = "/rw/mastership/rapid?action=request", "/rw/mastership/edit/request"
        answer = self._post(path_1 if self.version == 1 else path_2, {})
        if answer.status not in (200, 204):
            message = f"mastership of RAPID is refused ({_why(answer)}): another client holds it"
            hint = "release it at the pendant or in RobotStudio, and try again"
            raise issue_error("upload.busy", message, hint=hint)

    def release(self) -> bool:
        """Release mastership, and return whether the controller confirms it."""
        path_1, path_2 = "/rw/mastership/rapid?action=release", "/rw/mastership/edit/release"
        return self._post(path_1 if self.version == 1 else path_2, {}).status in (200, 204)

    # ---- files ----

    def listing(self, folder: str) -> dict[str, bool] | None:
        """Return whether each entry of a folder is a folder, by name; None if there is no such folder."""
        path = self._file(folder)
        answer = self._get(path)
        if answer.status == 404:
            return None
        items = [
            item for item in _all(self._read(path, answer)) if str(item.get("_type", "")).startswith("fs-")
        ]
        return {
            str(item["_title"]): str(item["_type"]).startswith("fs-dir") for item in items if "_title" in item
        }

    def make(self, folder: str) -> None:
        """Create a folder in an existing one."""
        parent, _, name = folder.rpartition("/")
        if self.version == 1:
            answer = self._post(self._file(parent), {"fs-newname": name, "fs-action": "create"})
        else:
            answer = self._post(f"{self._file(parent)}/create", {"fs-newname": name})
        if answer.status not in (200, 201, 204):
            raise self._unwritten(folder, answer)

    def write(self, name: str, content: bytes) -> None:
        """Write a file."""
        kind = "application/octet-stream" + ("" if self.version == 1 else ";v=2.0")
        answer = self.link.ask("PUT", self._file(name), content, self._headers({"Content-Type": kind}))
        if answer.status not in (200, 201, 204):
            raise self._unwritten(name, answer)

    def read(self, name: str) -> bytes | None:
        """Return the content of a file; None if there is no such file."""
        answer = self.link.ask("GET", self._file(name), None, self._headers())
        if answer.status == 404:
            return None
        if answer.status != 200:
            raise self._strange(name, answer)
        return answer.body

    def remove(self, name: str) -> bool:
        """Delete a file or an empty folder, and return whether it no longer exists."""
        return self.link.ask("DELETE", self._file(name), None, self._headers()).status in (200, 204, 404)

    def close(self) -> None:
        """End the session, of which a controller has a limited number, and the connection."""
        with contextlib.suppress(TandemError):  # not essential: sessions expire by themselves
            self.link.ask("GET", "/logout", None, self._headers())
        self.link.close()

    # ---- requests ----

    def _file(self, name: str) -> str:
        """Return the path of a file or folder in the home folder."""
        home = "$home" if self.version == 1 else "$HOME"
        return "/".join(["/fileservice", home, *(quote(part) for part in name.split("/") if part)])

    def _headers(self, additional: dict[str, str] | None = None) -> dict[str, str]:
        accept = {} if self.version == 1 else {"Accept": "application/hal+json;v=2.0"}
        return {**accept, **(additional or {})}

    def _get(self, path: str) -> Answer:
        full_path = path + ("&" if "?" in path else "?") + "json=1" if self.version == 1 else path
        return self.link.ask("GET", full_path, None, self._headers())

    def _post(self, path: str, values: dict[str, str]) -> Answer:
        kind = "application/x-www-form-urlencoded" + ("" if self.version == 1 else ";v=2.0")
        return self.link.ask("POST", path, urlencode(values).encode(), self._headers({"Content-Type": kind}))

    def _read(self, path: str, answer: Answer) -> dict[str, Any]:
        """Return the JSON object of an answer; raise ``TandemError`` if it has none."""
        if answer.status != 200:
            raise self._strange(path, answer)
        try:
            data = json.loads(answer.body)
        except (ValueError, RecursionError) as error:
            raise self._strange(path, answer) from error
        if not isinstance(data, dict):
            raise self._strange(path, answer)
        return data

    def _items(self, path: str) -> list[dict[str, Any]]:
        """Return all objects of a list, from all of its pages."""
        out: list[dict[str, Any]] = []
        next_page: str | None = path
        for _ in range(MAX_PAGES):
            if next_page is None:
                return out
            answer = self._get(next_page)
            data = self._read(next_page, answer)
            if not {"_embedded", "state"} & data.keys():  # not a list, so missing items prove nothing
                raise self._strange(next_page, answer)
            out += _all(data)
            link, base = (_link(data, name) for name in ("next", "base"))
            next_page = None if not link else self._next(link, base, path)
        raise issue_error("upload.controller", f"{path}: over {MAX_PAGES} pages")

    def _named(self, path: str, kind: str) -> dict[str, dict[str, Any]]:
        """Return the entries of a list whose type starts with ``kind``, by their names.

        Raises ``TandemError`` if one has no name, or if all entries are of other types: an unknown format
        must not look like an empty list.
        """
        entries = [item for item in self._items(path) if "_type" in item]
        matching = [item for item in entries if str(item["_type"]).startswith(kind)]
        nameless = next((item for item in matching if not isinstance(item.get("name"), str)), None)
        if nameless is not None or (entries and not matching):
            text = (
                f"{path}: a {kind} has no name" if nameless is not None else f"{path}: no {kind} in the list"
            )
            raise issue_error("upload.controller", text)
        return {item["name"]: item for item in matching}

    def _next(self, link: str, base: str | None, path: str) -> str:
        """Return the path and query of the next page of the list at ``path``.

        ``link`` is relative to the page's ``base`` if it states one, and has ampersands as in XML. Raises
        ``TandemError`` if it leads to another machine.
        """
        try:
            start = urljoin(f"{self.link.url}/", base or f"{path.partition('?')[0].rpartition('/')[0]}/")
            target = urlsplit(urljoin(start, html.unescape(link)))
        except ValueError as error:
            raise issue_error("upload.controller", f"{path}: {link!r} is not a valid next page") from error
        # _get adds json=1 again
        query = [(key, value) for key, value in parse_qsl(target.query) if key != "json"]
        if base is None and target.netloc != urlsplit(self.link.url).netloc:
            raise issue_error(
                "upload.controller", f"{path}: the next page is on another server or path ({link})"
            )
        return target.path + (f"?{urlencode(query)}" if query else "")

    def _value(self, path: str, key: str) -> str:
        """Return the first value of a key in an answer, at any depth."""
        answer = self._get(path)
        for item in _all(self._read(path, answer)):
            if key in item:
                return str(item[key])
        raise self._strange(path, answer)

    def _strange(self, path: str, answer: Answer) -> TandemError:
        """Return the error of an unexpected answer, with a hint by its status."""
        text = f"{self.link.url}{path} does not answer like RWS {self.version}.0: {_why(answer)}"
        hint = "check that --rws is the controller's version"
        if answer.status >= 500:
            text = f"{self.link.url}{path}: the controller cannot answer now: {_why(answer)}"
            hint = "try again later; sessions are limited, and interrupted ones count until they expire"
        elif 300 <= answer.status < 400:
            text = f"{self.link.url}{path}: {_why(answer)} redirects elsewhere, where no password is sent"
            hint = "give the controller's own address; RobotWare 7 is reached by https://"
        return issue_error("upload.controller", text, hint=hint)

    def _unwritten(self, name: str, answer: Answer) -> TandemError:
        """Return the error that a file could not be written, and whether the disk is full."""
        is_disk_full = (
            answer.status == 507 or b"space" in answer.body.lower() or b"full" in answer.body.lower()
        )
        text = f"{name} could not be written: {_why(answer)}" + ("; the disk is full" if is_disk_full else "")
        hint = (
            "free disk space, then send again"
            if is_disk_full
            else "check the user's rights on the controller"
        )
        return issue_error("upload.write", text, hint=hint)


def _link(data: dict[str, Any], name: str) -> str | None:
    """Return the target of the link ``name`` of an answer; None if it has no such link."""
    links = data.get("_links")
    link = links.get(name) if isinstance(links, dict) else None
    href = link.get("href") if isinstance(link, dict) else None
    return str(href) if href else None


def _all(data: Any) -> Iterator[dict[str, Any]]:
    """Yield all objects of an answer, at any depth.

    1.0 has them in ``_embedded._state``, 2.0 in ``state`` and ``_embedded.resources``.
    """
    if isinstance(data, dict):
        yield data
        for value in data.values():
            yield from _all(value)
    elif isinstance(data, list):
        for value in data:
            yield from _all(value)


def _attributes(items: Iterable[dict[str, Any]]) -> dict[str, str]:
    """Return the values of the attributes of a configuration instance, by name."""
    attributes = (
        nested
        for item in items
        for nested in _all(item)
        if str(nested.get("_type", "")).startswith("cfg-ia-t")
    )
    return {
        str(attribute["_title"]): str(attribute.get("value", ""))
        for attribute in attributes
        if "_title" in attribute
    }


def _why(answer: Answer) -> str:
    """Return the status of an answer and the start of its body, for messages."""
    text = " ".join(answer.body[:200].decode("utf-8", "replace").split())
    return f"HTTP {answer.status}" + (f" {text}" if text else "")

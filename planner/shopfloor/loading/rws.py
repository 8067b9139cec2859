"""ABB controllers over Robot Web Services: states, configuration and files.

Never a start, a pointer or a mode.

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
"""Maximum number of pages of one list."""


class Rws:
    """A controller with RWS ``version`` 1 or 2."""

    def __init__(self, link: Link, version: int) -> None:
        self.link, self.version = link, version

    # ---- states ----

    @property
    def mode(self) -> str:
        """AUTO, MANR, MANF ..."""
        return self._value("/rw/panel/opmode", "opmode")

    @property
    def state(self) -> str:
        """motoron, motoroff, guardstop ..."""
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
        """Installed options."""
        path = "/rw/system/options"
        out = tuple(str(one["option"]) for one in self._items(path) if "option" in one)
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
        """Names of the modules loaded in a task."""
        one, two = f"/rw/rapid/modules?task={quote(task)}", f"/rw/rapid/tasks/{quote(task)}/modules"
        return tuple(self._named(one if self.version == 1 else two, "rap-module-info"))

    @property
    def signals(self) -> dict[str, str]:
        """Types (DO, DI ...) of all signals, by name."""
        items = self._named("/rw/iosystem/signals", "ios-signal")
        return {name: str(one.get("type", "")) for name, one in items.items()}

    @property
    def robots(self) -> dict[str, dict[str, str]]:
        """Attributes of each instance of ROBOT in MOC.cfg, by its name."""
        out: dict[str, dict[str, str]] = {}
        path = "/rw/cfg/moc/ROBOT/instances"
        for one in self._items(path):
            if str(one.get("_type", "")).startswith("cfg-dt-instance") and "_title" in one:
                name = str(one["_title"])
                out[name] = _attributes([one]) or _attributes(self._items(f"{path}/{quote(name)}"))
        return out

    def datum(self, task: str, module: str, name: str) -> str | None:
        """Current text of a RAPID datum; None if the controller reports no datum of that name.

        The status is 404 then, or 400 with a code of its own.
        """
        where = f"RAPID/{quote(task)}/{quote(module)}/{quote(name)}"
        path = f"/rw/rapid/symbol/data/{where}" if self.version == 1 else f"/rw/rapid/symbol/{where}/data"
        answer = self._get(path)
        if answer.status in (400, 404):
            return None
        values = [one["value"] for one in _all(self._read(path, answer)) if "value" in one]
        return str(values[0]) if values else None

    def hold(self) -> None:
        """Take mastership of RAPID, so that nobody else changes it meanwhile.

        Raises:
            TandemError: ``upload.busy``.
        """
        one, two = "/rw/mastership/rapid?action=request", "/rw/mastership/edit/request"
        answer = self._post(one if self.version == 1 else two, {})
        if answer.status not in (200, 204):
            what = f"mastership of RAPID is refused ({_why(answer)}): another client holds it"
            hint = "release it at the pendant or in RobotStudio, and try again"
            raise issue_error("upload.busy", what, hint=hint)

    def release(self) -> bool:
        """Release mastership; returns whether the controller confirms it."""
        one, two = "/rw/mastership/rapid?action=release", "/rw/mastership/edit/release"
        return self._post(one if self.version == 1 else two, {}).status in (200, 204)

    # ---- files ----

    def listing(self, folder: str) -> dict[str, bool] | None:
        """{name: whether it is a folder} under the home folder; None if there is no such folder."""
        path = self._file(folder)
        answer = self._get(path)
        if answer.status == 404:
            return None
        items = [i for i in _all(self._read(path, answer)) if str(i.get("_type", "")).startswith("fs-")]
        return {str(i["_title"]): str(i["_type"]).startswith("fs-dir") for i in items if "_title" in i}

    def make(self, folder: str) -> None:
        """Create a folder in an existing one."""
        above, _, name = folder.rpartition("/")
        if self.version == 1:
            answer = self._post(self._file(above), {"fs-newname": name, "fs-action": "create"})
        else:
            answer = self._post(f"{self._file(above)}/create", {"fs-newname": name})
        if answer.status not in (200, 201, 204):
            raise self._unwritten(folder, answer)

    def write(self, name: str, content: bytes) -> None:
        """Write a file."""
        kind = "application/octet-stream" + ("" if self.version == 1 else ";v=2.0")
        answer = self.link.ask("PUT", self._file(name), content, self._headers({"Content-Type": kind}))
        if answer.status not in (200, 201, 204):
            raise self._unwritten(name, answer)

    def read(self, name: str) -> bytes | None:
        """Content of a file; None if there is none."""
        answer = self.link.ask("GET", self._file(name), None, self._headers())
        if answer.status == 404:
            return None
        if answer.status != 200:
            raise self._strange(name, answer)
        return answer.body

    def remove(self, name: str) -> bool:
        """Delete a file or an empty folder; returns whether it is gone."""
        return self.link.ask("DELETE", self._file(name), None, self._headers()).status in (200, 204, 404)

    def close(self) -> None:
        """End the session, of which a controller has a limited number, and the connection."""
        with contextlib.suppress(TandemError):  # not essential: sessions expire by themselves
            self.link.ask("GET", "/logout", None, self._headers())
        self.link.close()

    # ---- requests ----

    def _file(self, name: str) -> str:
        home = "$home" if self.version == 1 else "$HOME"
        return "/".join(["/fileservice", home, *(quote(part) for part in name.split("/") if part)])

    def _headers(self, more: dict[str, str] | None = None) -> dict[str, str]:
        return {**({} if self.version == 1 else {"Accept": "application/hal+json;v=2.0"}), **(more or {})}

    def _get(self, path: str) -> Answer:
        answer = path + ("&" if "?" in path else "?") + "json=1" if self.version == 1 else path
        return self.link.ask("GET", answer, None, self._headers())

    def _post(self, path: str, values: dict[str, str]) -> Answer:
        kind = "application/x-www-form-urlencoded" + ("" if self.version == 1 else ";v=2.0")
        return self.link.ask("POST", path, urlencode(values).encode(), self._headers({"Content-Type": kind}))

    def _read(self, path: str, answer: Answer) -> dict[str, Any]:
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
        """All objects of a list, page by page."""
        out: list[dict[str, Any]] = []
        following: str | None = path
        for _ in range(MAX_PAGES):
            if following is None:
                return out
            answer = self._get(following)
            data = self._read(following, answer)
            if not {"_embedded", "state"} & data.keys():  # not a list, so missing items prove nothing
                raise self._strange(following, answer)
            out += _all(data)
            link, base = (_link(data, name) for name in ("next", "base"))
            following = None if not link else self._next(link, base, path)
        raise issue_error("upload.controller", f"{path}: over {MAX_PAGES} pages")

    def _named(self, path: str, kind: str) -> dict[str, dict[str, Any]]:
        """Entries of a list that are of one kind, by their names.

        Raises ``TandemError`` if one has no name, or if all are of other kinds: an unknown format must not
        look like an empty list.
        """
        entries = [one for one in self._items(path) if "_type" in one]
        own = [one for one in entries if str(one["_type"]).startswith(kind)]
        bad = next((one for one in own if not isinstance(one.get("name"), str)), None)
        if bad is not None or (entries and not own):
            what = f"{path}: a {kind} has no name" if bad is not None else f"{path}: no {kind} in the list"
            raise issue_error("upload.controller", what)
        return {one["name"]: one for one in own}

    def _next(self, link: str, base: str | None, path: str) -> str:
        """Path of the next page.

        Links are relative to the page's ``base`` if it states one, and have ampersands as in XML. Raises
        ``TandemError`` if they lead to another machine.
        """
        try:
            start = urljoin(f"{self.link.url}/", base or f"{path.partition('?')[0].rpartition('/')[0]}/")
            whole = urlsplit(urljoin(start, html.unescape(link)))
        except ValueError as error:
            raise issue_error("upload.controller", f"{path}: {link!r} is not a valid next page") from error
        kept = [(k, v) for k, v in parse_qsl(whole.query) if k != "json"]
        if base is None and whole.netloc != urlsplit(self.link.url).netloc:
            raise issue_error(
                "upload.controller", f"{path}: the next page is on another server or path ({link})"
            )
        return whole.path + (f"?{urlencode(kept)}" if kept else "")

    def _value(self, path: str, key: str) -> str:
        answer = self._get(path)
        for one in _all(self._read(path, answer)):
            if key in one:
                return str(one[key])
        raise self._strange(path, answer)

    def _strange(self, path: str, answer: Answer) -> TandemError:
        what = f"{self.link.url}{path} does not answer like RWS {self.version}.0: {_why(answer)}"
        hint = "check that --rws is the controller's version"
        if answer.status >= 500:
            what = f"{self.link.url}{path}: the controller cannot answer now: {_why(answer)}"
            hint = "try again later; sessions are limited, and interrupted ones count until they expire"
        elif 300 <= answer.status < 400:
            what = f"{self.link.url}{path}: {_why(answer)} redirects elsewhere, where no password is sent"
            hint = "give the controller's own address; RobotWare 7 is reached by https://"
        return issue_error("upload.controller", what, hint=hint)

    def _unwritten(self, name: str, answer: Answer) -> TandemError:
        full = answer.status == 507 or b"space" in answer.body.lower() or b"full" in answer.body.lower()
        what = f"{name} could not be written: {_why(answer)}" + ("; the disk is full" if full else "")
        hint = "free disk space, then send again" if full else "check the user's rights on the controller"
        return issue_error("upload.write", what, hint=hint)


def _link(data: dict[str, Any], name: str) -> str | None:
    """Target of a link of an answer; None if it has none."""
    links = data.get("_links")
    link = links.get(name) if isinstance(links, dict) else None
    href = link.get("href") if isinstance(link, dict) else None
    return str(href) if href else None


def _all(data: Any) -> Iterator[dict[str, Any]]:
    """All objects of an answer, at any depth.

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
    """Names and values of the attributes of a configuration instance."""
    inside = (i for one in items for i in _all(one) if str(i.get("_type", "")).startswith("cfg-ia-t"))
    return {str(i["_title"]): str(i.get("value", "")) for i in inside if "_title" in i}


def _why(answer: Answer) -> str:
    text = " ".join(answer.body[:200].decode("utf-8", "replace").split())
    return f"HTTP {answer.status}" + (f" {text}" if text else "")

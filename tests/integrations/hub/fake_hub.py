"""A model hub on this machine, with as much of Hugging Face's HTTP API as an agent's way there and back takes."""

import base64
import hashlib
import json
import re
import threading
import time
from collections.abc import Callable
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from urllib.parse import unquote, urlsplit

import yaml

NAME = "owner/reach"
FILES = ("agent.onnx", "agent.json", "curve.csv")

TOKEN = "hf_of_the_owner"
OWNER = "owner"


class FakeHub(ThreadingHTTPServer):
    """Repositories by name. `asked` is what was requested, `failing` gives a status by a request's pattern."""

    daemon_threads = True

    def __init__(self):
        super().__init__(("127.0.0.1", 0), Handler)
        self.repositories, self.asked, self.failing, self.stored = {}, [], {}, {}
        self.lfs = False
        self.address = f"http://127.0.0.1:{self.server_port}"

    def put(self, name, files, private=False):
        """Add a commit. A file is its content, or a function that writes the answer to a handler."""
        repository = self.repositories.setdefault(name, {"private": private, "commits": {}})
        content = "".join(f"{file}{body}" for file, body in sorted(files.items()))
        commit = hashlib.sha1(f"{len(repository['commits'])}{content}".encode()).hexdigest()
        repository["commits"][commit] = files
        return commit

    def files(self, name):
        """The newest commit's."""
        return list(self.repositories[name]["commits"].values())[-1]


@contextmanager
def serving():
    with FakeHub() as hub:
        thread = threading.Thread(target=hub.serve_forever, args=(0.01,))
        thread.start()
        try:
            yield hub
        finally:
            hub.shutdown()
            thread.join()


class Handler(BaseHTTPRequestHandler):
    server: FakeHub
    protocol_version = "HTTP/1.1"

    def log_message(self, *_):
        pass

    def start(self, status, headers):
        self.send_response(status)
        for name, value in headers.items():
            self.send_header(name, str(value))
        self.end_headers()

    def send(self, body, status=200, **headers):
        body = body if isinstance(body, bytes) else json.dumps(body).encode()
        names = {name.replace("_", "-"): value for name, value in headers.items()}
        self.start(status, {"Content-Length": len(body), **names})
        if self.command != "HEAD":
            self.wfile.write(body)

    def missing(self, what):
        self.send({"error": f"{what} is not there"}, 404, X_Error_Code=what)

    def answer(self):
        self.path = urlsplit(self.path).path
        self.body = self.rfile.read(int(self.headers.get("Content-Length", 0)))
        request = f"{self.command} {self.path}"
        self.server.asked.append(request)
        for pattern, status in self.server.failing.items():
            if re.search(pattern, request):
                return self.send({"error": "so it was decided"}, status)
        for pattern, method in ROUTES:
            if found := re.fullmatch(pattern, request):
                return method(self, *map(unquote, found.groups()))
        return self.missing("RepoNotFound")

    do_GET = do_HEAD = do_POST = do_PUT = answer  # noqa: N815 - as http.server calls them

    def may_write(self, name):
        if self.headers.get("Authorization") != f"Bearer {TOKEN}":
            self.send({"error": "Invalid username or password."}, 401)
            return False
        if not name.startswith(f"{OWNER}/"):
            self.send({"error": "You don't have the rights to create a model under this namespace"}, 403)
            return False
        return True

    def create(self):
        wanted = json.loads(self.body)
        name = f"{wanted['organization']}/{wanted['name']}"
        if not self.may_write(name):
            return
        url = f"{self.server.address}/{name}"
        if name in self.server.repositories:
            self.send({"error": "You already created this model repo", "url": url}, 409)
            return
        self.server.put(name, {}, private=wanted.get("visibility") == "private")
        self.send({"url": url})

    def validate(self):
        values = yaml.safe_load(json.loads(self.body)["content"].split("---")[1])
        wrong = values.get("license") not in (None, "mit", "apache-2.0")
        errors = [{"message": '"license" must be one of [apache-2.0, mit]'}] if wrong else []
        self.send({"errors": errors, "warnings": []}, 400 if wrong else 200)

    def preupload(self, name, _):
        if self.may_write(name):
            modes = {True: "lfs", False: "regular"}
            self.send(
                {
                    "files": [
                        {
                            "path": file["path"],
                            "uploadMode": modes[self.server.lfs and file["path"].endswith(".onnx")],
                            "shouldIgnore": False,
                            "oid": None,
                        }
                        for file in json.loads(self.body)["files"]
                    ]
                }
            )

    def batch(self, name):
        if self.may_write(name):
            self.send(
                {
                    "transfer": "basic",
                    "objects": [
                        {**one, "actions": {"upload": {"href": f"{self.server.address}/stored/{one['oid']}"}}}
                        for one in json.loads(self.body)["objects"]
                    ],
                }
            )

    def store(self, oid):
        assert hashlib.sha256(self.body).hexdigest() == oid
        self.server.stored[oid] = self.body
        self.send({})

    def commit(self, name, _):
        if not self.may_write(name):
            return
        files = dict(self.server.files(name))
        for line in map(json.loads, self.body.splitlines()):
            match line:
                case {"key": "file", "value": value}:
                    files[value["path"]] = base64.b64decode(value["content"])
                case {"key": "lfsFile", "value": value}:
                    files[value["path"]] = self.server.stored[value["oid"]]
                case {"key": "deletedFile", "value": value}:
                    del files[value["path"]]
        commit = self.server.put(name, files)
        self.send({"success": True, "commitOid": commit, "commitUrl": f"{self.server.address}/{name}/commit/{commit}"})

    def found(self, name, revision):
        """The commit that a revision is; None after an answer that there is none."""
        repository = self.server.repositories.get(name)
        if repository is None or (repository["private"] and self.headers.get("Authorization") != f"Bearer {TOKEN}"):
            return self.missing("RepoNotFound")
        commits = list(repository["commits"])
        commit = commits[-1] if revision == "main" else revision
        return commit if commit in commits else self.missing("RevisionNotFound")

    def info(self, name, revision="main"):
        if commit := self.found(name, revision):
            self.send({"id": name, "sha": commit, "private": self.server.repositories[name]["private"]})

    def resolve(self, name, revision, file):
        if commit := self.found(name, revision):
            content = self.server.repositories[name]["commits"][commit].get(file)
            if content is None:
                self.missing("EntryNotFound")
            elif callable(content):
                content(self)
            else:
                self.send(content, X_Repo_Commit=commit, ETag='"1"')


REPOSITORY = r"([\w.-]+/[\w.-]+)"
ROUTES: list[tuple[str, Callable[..., None]]] = [
    (r"POST /api/repos/create", Handler.create),
    (r"POST /api/validate-yaml", Handler.validate),
    (rf"POST /api/models/{REPOSITORY}/preupload/(.+)", Handler.preupload),
    (rf"POST /api/models/{REPOSITORY}/commit/(.+)", Handler.commit),
    (rf"POST /{REPOSITORY}\.git/info/lfs/objects/batch", Handler.batch),
    (r"PUT /stored/(\w+)", Handler.store),
    (rf"GET /api/models/{REPOSITORY}/revision/(.+)", Handler.info),
    (rf"GET /api/models/{REPOSITORY}", Handler.info),
    (rf"(?:GET|HEAD) /{REPOSITORY}/resolve/([^/]+)/(.+)", Handler.resolve),
]


def huge(handler):
    """Answer with the beginning of a file of a terabyte."""
    handler.start(200, {"Content-Length": 10**12})
    handler.wfile.write(bytes(1000))


def endless(handler):
    """Answer with zeros, until nobody reads them."""
    handler.start(200, {"Transfer-Encoding": "chunked"})
    try:
        while True:
            handler.wfile.write(b"10000\r\n" + bytes(0x10000) + b"\r\n")
    except OSError:
        handler.close_connection = True


def trickling(handler):
    """Answer with a byte now and then, for ever."""
    handler.start(200, {"Transfer-Encoding": "chunked"})
    try:
        while True:
            handler.wfile.write(b"1\r\n \r\n")
            time.sleep(0.02)
    except OSError:
        handler.close_connection = True


def broken_off(content):
    """Answer with the first half of a file, and hang up."""

    def answer(handler):
        handler.start(200, {"Content-Length": len(content)})
        handler.wfile.write(content[: len(content) // 2])
        handler.close_connection = True

    return answer


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.name in FILES}


def published(hub, folder, **changes):
    """Put an agent on the hub as it is, with some files changed; None leaves one out."""
    files = contents(folder) | changes
    return hub.put(NAME, {name: content for name, content in files.items() if content is not None})

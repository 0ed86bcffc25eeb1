"""The page of the viewer is for those who have its address; names and meshes of files are data on
it.
"""

from __future__ import annotations

import gzip
import html.parser
import http.client
import io
import json
import os
import random
import shutil
import socket
import subprocess
import sys
import threading
import types
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

import numpy as np
import pytest
import trimesh
import viser
from chromium import draw_plainly
from command import Result
from websockets.datastructures import Headers
from websockets.exceptions import InvalidStatus
from websockets.http11 import Request
from websockets.sync.client import connect

import kempe
from kempe.description import meshes as mesh_files
from kempe.description.meshes import read_body_meshes, read_meshes
from kempe.views.viewer import live
from kempe.views.viewer.live import Page, Viewer
from kempe.views.viewer.scene_nodes import Drawn
from kempe.views.viewer.server import Guard, PageServer
from kempe.views.viewer.session import Session

VISER = f"viser-v{viser.__version__}"
FOREIGN = "http://evil.example"


# ---- who may open it


def opened(url: str, origin: str | None, host: str | None = None) -> int | str:
    """Bytes of the first message that a page of an origin receives at a websocket, or the refusal."""
    scheme, _, rest = url.partition("://")
    place, _, path = rest.partition("/")
    name, _, port = place.partition(":")
    uri = f"ws://{f'{host}:{port}' if host else place}/{path}"
    with socket.create_connection((name, int(port)), 120.0) as way:
        try:
            with connect(
                uri,
                sock=way,
                origin=origin,
                subprotocols=[VISER],
                max_size=None,
                compression=None,
                open_timeout=120.0,
                proxy=None,
            ) as page:
                return len(page.recv(120.0))
        except InvalidStatus as error:
            return f"{error.response.status_code} {bytes(error.response.body).decode()}"


@contextmanager
def served(*options: str):
    """The address of a page that `kempe view` serves in a process of its own."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
    command = [
        sys.executable,
        "-c",
        "from kempe.cli import main; main()",
        "view",
        "two_link",
        "--no-browser",
        "--json",
    ]
    with subprocess.Popen(
        [*command, *options], stdout=subprocess.PIPE, text=True, env=environment
    ) as process:
        try:
            assert process.stdout is not None
            text = ""
            while text.count("{") != text.count("}") or "{" not in text:
                line = process.stdout.readline()
                assert line, "it has ended"
                text += line
            yield json.loads(text)["url"]
        finally:
            process.terminate()


@pytest.mark.slow
def test_only_who_has_the_address_and_comes_from_the_page_opens_a_websocket():
    """As an attacker would: without the token, from a foreign page, without an origin, by DNS
    rebinding.
    """
    with served("--port", "0") as url:
        base, _, token = url.rpartition("/")
        assert len(token) >= 32 and base.startswith("http://127.0.0.1:")
        port = base.rpartition(":")[2]
        assert int(opened(url, base)) > 0
        assert int(opened(url, f"http://localhost:{port}", "localhost")) > 0
        for address, origin, host, why in (
            (base, base, None, "the address is incomplete"),
            (f"{base}/{token[:-1]}", base, None, "the address is incomplete"),
            (f"{base}/x/{token}", base, None, "the address is incomplete"),
            (url, FOREIGN, None, "another origin"),
            (url, None, None, "another origin"),
            (url, "null", None, "another origin"),
            (url, "http://127.0.0.1:1", None, "another origin"),
            (url, f"http://localhost:{port}", None, "another origin"),
            (url, f"{FOREIGN}:{port}", "evil.example", "names a host"),
            (url, base, "evil.example", "names a host"),
        ):
            said = opened(address, origin, host)
            assert str(said).startswith("403 Refused") and why in str(said), (
                address,
                origin,
                host,
                said,
            )


def test_the_page_itself_needs_the_token_and_may_load_nothing_from_elsewhere():
    with kempe.load("two_link").show(port=0, browser=False) as viewer:
        place, _, token = viewer.url.removeprefix("http://").partition("/")
        for path, host, code in (
            (f"/{token}", place, 200),
            (f"/{token}/index.html", place, 200),
            ("/", place, 403),
            (f"/{token}a", place, 403),
            (f"/{token}", "evil.example", 403),
            (f"/{token}/nothing", place, 404),
        ):
            connection = http.client.HTTPConnection(place)
            connection.request("GET", path, headers={"Host": host})
            answer = connection.getresponse()
            body = answer.read()
            assert answer.status == code, path
            policy = answer.getheader("Content-Security-Policy") or ""
            assert (code == 200) == ("default-src 'none'" in policy) or code == 404
            assert token.encode() not in body
            assert (b"<title>two_link</title>" in body) == (code == 200)
            connection.close()


def test_two_servers_have_two_tokens_and_other_servers_of_viser_are_as_they_were():
    plain = viser.infra.WebsockServer._background_worker
    first = PageServer(port=0)
    second = PageServer(port=0)
    assert (
        first.guard.token != second.guard.token
        and viser.infra.WebsockServer._background_worker is plain
    )
    other = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    assert int(opened(f"http://127.0.0.1:{other.get_port()}/", FOREIGN)) > 0
    for server in (first, second, other):
        server.stop()


def test_a_viser_that_is_built_otherwise_serves_nothing(monkeypatch):
    """Where its server does not ask the guard, there is an error and no page."""
    worker = viser.infra.WebsockServer._background_worker
    monkeypatch.setattr("kempe.views.viewer.server._bind_globals", lambda f, **_: f)
    with pytest.raises(kempe.errors.UnsupportedError, match="viser"):
        PageServer(port=0)
    assert viser.infra.WebsockServer._background_worker is worker


def test_requests_with_anything_else_are_refused(hunt):
    """Letters of the token, the host or the origin are changed, left out or added, or a header
    comes twice.
    """
    rng = random.Random(int(hunt.rng().integers(2**32)))
    letters = "abcxyzABCXYZ0123456789-_./:@%#"
    refused = 0
    for _ in range(hunt.cases(4000)):
        guard = Guard()
        host = rng.choice(["127.0.0.1:8080", "localhost:9", "[::1]:80", "LOCALHOST"])
        parts = {"token": guard.token, "host": host, "origin": f"http://{host}"}
        assert ask(guard, parts["token"], [host], [parts["origin"]]) is None
        which = rng.choice(list(parts))
        while (text := changed(rng, parts[which], letters)) == parts[which]:
            pass
        wrong = {**parts, which: text}
        if rng.random() < 0.2 and which != "token":  # beside the right one
            token = parts["token"]
            hosts = [host]
            origins = [parts["origin"]]
            (hosts if which == "host" else origins).append(text)
        else:
            token = wrong["token"]
            hosts = [wrong["host"]]
            origins = [wrong["origin"]]
        answer = ask(guard, token, hosts, origins)
        if which == "token" and text.startswith((f"{parts['token']}/", f"{parts['token']}?")):
            continue  # the token, and a path after it
        assert answer is not None and answer.status_code == 403, (which, text)
        refused += 1
    assert refused


def ask(guard: Guard, token: str, hosts: list[str], origins: list[str]):
    """What a guard answers to the request for a websocket."""
    headers = Headers([*(("Host", x) for x in hosts), *(("Origin", x) for x in origins)])
    return guard.answer_request(None, Request(f"/{token}", headers), lambda *_: None)


def changed(rng: random.Random, text: str, letters: str) -> str:
    """A text in which some letters are others, are left out or are added."""
    out = list(text)
    for _ in range(rng.randint(1, 3)):
        at = rng.randint(0, len(out))
        out[at : at + rng.randint(0, 1)] = rng.choice(["", *letters])
    return "".join(out)


@contextmanager
def website(page: str = ""):
    """The address of a web server on this machine, and the paths that were requested from it."""
    asked: list[str] = []

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self):
            asked.append(self.path)
            self.send_response(200)
            self.send_header("Content-Type", "text/html")
            self.end_headers()
            self.wfile.write(page.encode())

        def log_message(self, *_):
            pass

    server = HTTPServer(("127.0.0.1", 0), Handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield f"127.0.0.1:{server.server_port}", asked
    finally:
        server.shutdown()
        server.server_close()


@pytest.mark.slow
def test_another_page_in_the_same_browser_cannot_open_the_websocket(browser):
    """Not with the address, and not as a frame of it; the page itself can, also in a frame as in a
    notebook.
    """
    script = """([url, protocol]) => new Promise(done => {
        const s = new WebSocket(url, [protocol]);
        s.onmessage = () => done("open"); s.onclose = () => done("closed")})"""
    with (
        kempe.load("two_link").show(port=0, browser=False) as viewer,
        website("<p>foreign</p>") as (site, _),
    ):
        draw_plainly(viewer.server)
        tab = browser.new_page()
        tab.goto(f"http://{site}/")
        for url in (viewer.url, viewer.url.rpartition("/")[0]):
            assert tab.evaluate(script, [url.replace("http", "ws"), VISER]) == "closed"
        assert not viewer.pages
        tab.evaluate(
            "url => { document.body.innerHTML = `<iframe width=800 height=500 src='${url}'>` }",
            viewer.url,
        )
        tab.frame_locator("iframe").get_by_text("random", exact=True).wait_for()
        tab.close()


# ---- names are text


EVIL = '<img src="//{site}/a"> ![x](//{site}/b) **bold** <script>fetch("//{site}/c")</script> &lt;'


def named(site: str, tmp_path: Path) -> kempe.System:
    """A system whose names are all markup, with a mesh that is not there."""
    evil = EVIL.format(site=site)
    m = kempe.Mechanism(f"system {evil}", dim=3)
    body = m.body(f"body {evil}")
    other = m.body(f"other {evil}")
    m.revolute(f"joint {evil}", m.ground, body, limits=(-1.0, 1.0))
    m.prismatic(f"slide {evil}", body, other, at=(1.0, 0.0, 0.0), limits=(0.0, 1.0))
    m.frame(f"frame {evil}", other, at=(0.5, 0.0, 0.0))
    m.posture(f"posture {evil}", {f"joint {evil}": 0.5})
    return m.build()


class Tags(html.parser.HTMLParser):
    """What elements a page has."""

    def __init__(self, text: str):
        super().__init__()
        self.tags: list[tuple[str, str]] = []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs).get("src", "")))


def test_names_are_text_in_notebooks_and_on_saved_pages(tmp_path):
    system = named("host.example", tmp_path)
    frame = system.frame_names[-1]
    answers = (
        system,
        system.ik(system.fk(system.mid, frame), frame),
        system.mobility(),
        system.mechanism,
    )
    for answer in answers:
        tags = Tags(answer._repr_html_()).tags
        assert "script" not in dict(tags) and all(
            src.startswith("data:") for tag, src in tags if tag == "img"
        )
    system.save_html(tmp_path / "page.html")
    text = (tmp_path / "page.html").read_text()
    assert (
        'src="//host.example' not in text and "default-src 'none'" in text.partition("<script")[0]
    )


@pytest.mark.slow
def test_names_are_text_on_the_page_and_request_nothing(browser, tmp_path, monkeypatch):
    """With what a browser may load left open, too: the names are seen letter by letter, and no
    request leaves.
    """
    monkeypatch.setattr(
        "kempe.views.viewer.server.POLICY",
        "default-src * data: blob: 'unsafe-inline' 'unsafe-eval'",
    )
    with website() as (site, asked):
        system = named(site, tmp_path)
        with system.show(port=0, browser=False) as viewer:
            draw_plainly(viewer.server)
            tab = browser.new_page(viewport={"width": 1000, "height": 900})
            requests = []
            tab.on("request", lambda r: requests.append(r.url))
            tab.goto(viewer.url)
            tab.get_by_text("random", exact=True).wait_for()
            for box in ("names", "axes of frames"):
                tab.get_by_text(box, exact=True).click()
            page = next(iter(viewer.pages.values()))
            sentence = f"said {EVIL.format(site=site)}"
            page.post_action("say", lambda: page._show_text(sentence))
            tab.get_by_text("said <img").first.wait_for()
            assert sentence.split()[1] in tab.content() or "&lt;img" in tab.content()
            tab.wait_for_timeout(1500)
            assert (
                not tab.locator("img[src*='/a']").count()
                and not tab.locator("img[src*='/b']").count()
            )
            tab.close()
        system.save_html(tmp_path / "page.html")
        tab = browser.new_page()
        tab.on("request", lambda r: requests.append(r.url))
        tab.goto((tmp_path / "page.html").as_uri())
        tab.get_by_text("Sliders need the live page").wait_for()
        tab.wait_for_timeout(1500)
        tab.close()
    assert not asked and not [r for r in requests if site in r]


# ---- sliders


@pytest.fixture
def page_of(monkeypatch) -> Iterator[Callable[..., Page]]:
    """Makes pages whose messages go to all clients, of whom there are none, and that do nothing by
    themselves.
    """
    viewers = []
    monkeypatch.setattr(Page, "_run_actions", lambda page: None)

    def made(system: kempe.System, deg: bool = False) -> Page:
        session = Session(system)
        viewers.append(Viewer(session, True, 0, deg))
        return Page(viewers[-1], viewers[-1].server, session, viewers[-1].drawn)

    yield made
    for viewer in viewers:
        viewer.close()


@pytest.mark.parametrize("name", ["jansen", "two_link", "klann", "ball"])
def test_sliders_show_the_value_that_is_beyond_a_turn_too(name, page_of):
    """Also where an angle has wound up, and back."""
    system = kempe.load(name)
    page = page_of(system)
    session = page.session
    page.show()
    for turns in (0.0, 4.295, -3.5, 11.0, -40.0, 0.3):
        q = np.array(session.home)
        slider = session.sliders[0].name
        q[system.coordinate_names.index(slider)] = turns if name != "ball" else 0.1 * turns
        session.q = q
        page._set_sliders()
        for one in session.sliders:
            handle = page.sliders[one.name]
            assert (
                handle.value == pytest.approx(one.value, abs=1e-9)
                and handle.min <= handle.value <= handle.max
            )


def test_the_page_speaks_degrees_where_these_are_wanted(page_of):
    """By `deg=True`, and by the switch; limits in degrees are the limits, and lengths stay metres."""
    system = kempe.load("stanford")
    page = page_of(system, deg=True)
    page.show()
    for s in page.session.sliders:
        handle = page.sliders[s.name]
        factor = np.pi / 180.0 if s.unit == "rad" else 1.0
        assert np.allclose(
            np.array([handle.min, handle.max, handle.value]) * factor, [s.low, s.high, s.value]
        )
        assert handle.label.endswith("[deg]" if s.unit == "rad" else "[m]")
        page._set_coordinate(s.name, handle.max)
        q = dict(zip(system.coordinate_names, page.session.q, strict=True))[s.name]
        assert q == s.high
    page.degrees.value = False
    page._make_sliders()
    assert {h.label.rpartition(" ")[2] for h in page.sliders.values()} == {"[rad]", "[m]"}
    with kempe.load("two_link").show({"q1": 0.5}, deg=True, port=0, browser=False) as shown:
        assert shown.deg
    with pytest.raises(kempe.errors.InputError, match="deg is 'yes'; it must be True or False"):
        kempe.load("two_link").show(deg="yes", port=0, browser=False)


# ---- meshes are data


ROBOT = """<robot name="r">
<link name="base"><visual><geometry><box size="1 1 1"/></geometry></visual></link>{}</robot>"""
ARM = """<link name="{0}"><visual><geometry><mesh filename="{1}"/></geometry></visual></link>
<joint name="j{0}" type="revolute"><parent link="base"/><child link="{0}"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" effort="1" velocity="1"/></joint>"""


def robot(folder: Path, *files: str) -> kempe.System:
    """A robot with a body for each mesh file."""
    text = ROBOT.format("".join(ARM.format(f"b{k}", name) for k, name in enumerate(files)))
    (folder / "robot.urdf").write_text(text)
    return kempe.load(folder / "robot.urdf")


def packed(path: Path, inner: str, megabytes: int) -> None:
    """A small archive that unpacks to many blanks."""
    with (
        zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as z,
        z.open(inner, "w", force_zip64=True) as file,
    ):
        for _ in range(megabytes):
            file.write(b" " * (1 << 20))


def damaged(folder: Path) -> dict[str, str]:
    """Files that cannot be read, and what is said of some of them."""
    packed(folder / "bomb.zip", "a.stl", 201)
    for name in ("bomb.3mf", "bomb.zae"):
        shutil.copy(folder / "bomb.zip", folder / name)
    (folder / "bad.dae").write_text(
        "<COLLADA><library_geometries><geometry id='a'/></library_geometries></COLLADA>"
    )
    (folder / "text.dae").write_text("no XML")
    (folder / "bad.3mf").write_bytes(b"PK\x03\x04 no archive")
    with zipfile.ZipFile(folder / "open.3mf", "w") as z:
        z.writestr("3D/3dmodel.model", "<model><oops>")
    (folder / "bad.stl").write_bytes(b"\0" * 80 + b"\xff\xff\xff\x7f" + b"\0" * 50)
    (folder / "bad.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 4000000000\nproperty float x\nend_header\n0\n"
    )
    (folder / "bad.glb").write_bytes(b"glTF\x02\0\0\0\xff\xff\xff\x7f")
    (folder / "nan.obj").write_text("v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    (folder / "none.obj").write_text("v 0 0 0\n")
    (folder / "x.what").write_text("")
    (folder / "packed.stl.gz").write_bytes(gzip.compress(b" " * (1 << 20)))
    names = sorted(p.name for p in folder.iterdir() if p.suffix != ".urdf")
    return {n: "unpacks to" if n in ("bomb.zip",) else "" for n in names}


@pytest.mark.slow
def test_meshes_that_cannot_be_read_are_named_and_the_others_are_drawn(tmp_path):
    bad = damaged(tmp_path)
    trimesh.creation.box((1, 2, 3)).export(tmp_path / "good.stl")
    found, lost = read_body_meshes(robot(tmp_path, *bad, "good.stl", "good.stl").mechanism)
    assert set(found) == {"base", f"b{len(bad)}", f"b{len(bad) + 1}"}
    assert np.allclose(np.ptp(found[f"b{len(bad)}"][0].corners, axis=0), [1, 2, 3])
    assert len(lost) == len(bad)
    for (name, why), said in zip(bad.items(), lost, strict=True):
        assert name in said and why in said and len(said) < 500 and "\n" not in said, said


@pytest.mark.slow
def test_a_page_with_such_meshes_is_served_and_says_so(tmp_path):
    for name in ("bad.stl", "bad.3mf"):
        (tmp_path / name).write_bytes(b"no mesh")
    system = robot(tmp_path, "bad.stl", "bad.3mf")
    for act in (
        lambda: system.show(port=0, browser=False).close(),
        lambda: system.save_html(tmp_path / "x.html"),
    ):
        with pytest.warns(UserWarning, match=r"2 meshes not drawn: b0: mesh bad\.stl"):
            act()
    view = Result("view", tmp_path / "robot.urdf", "--html", tmp_path / "y.html")
    assert view.code == 0 and "written to" in view.out
    assert "2 meshes not drawn: b0: mesh bad.stl" in view.err


@pytest.mark.slow
def test_a_file_that_takes_too_long_or_too_much_is_ended_and_the_next_is_read(
    tmp_path, monkeypatch
):
    """By the processor's time, by memory, by death of the process: each is told from the others."""
    trimesh.creation.box((1, 2, 3)).export(tmp_path / "good.stl")
    names = ("loop.stl", "fat.stl", "dies.stl", "good.stl")
    for name in names[:3]:
        shutil.copy(tmp_path / "good.stl", tmp_path / name)
    traps = """
def trap(load):
    def trapped(path, **how):
        while "loop" in path: pass
        x = bytearray(1 << 40) if "fat" in path else None
        if "dies" in path: os._exit(3)
        return load(path, **how)
    return trapped
trimesh.load_mesh = trap(trimesh.load_mesh)
"""
    monkeypatch.setattr(mesh_files, "EACH", 1)
    monkeypatch.setattr(
        mesh_files,
        "_WORKER",
        mesh_files._WORKER.replace("class Refused", f"{traps}\nclass Refused"),
    )
    found = read_meshes((tmp_path / n, None) for n in names)
    said = [found[tmp_path / n, None] for n in names]
    assert (
        "takes more than 1 s" in said[0]
        and "of memory" in said[1]
        and "ended the process" in said[2]
    )
    assert np.allclose(np.ptp(said[3].corners, axis=0), [1, 2, 3])


@pytest.mark.slow
def test_meshes_keep_their_colours_and_textures(tmp_path):
    """What is read in the other process is what trimesh reads here."""
    box = trimesh.creation.box((1, 2, 3))
    box.visual.face_colors = [200, 30, 40, 255]
    box.export(tmp_path / "colours.ply")
    from PIL import Image

    picture = Image.new("RGB", (3000, 30), (10, 200, 30))
    uv = np.random.default_rng(0).uniform(size=(len(box.vertices), 2))
    textured = trimesh.Trimesh(
        box.vertices,
        box.faces,
        process=False,
        visual=trimesh.visual.TextureVisuals(uv=uv, image=picture),
    )
    textured.export(tmp_path / "texture.glb")
    found = read_meshes((tmp_path / n, None) for n in ("colours.ply", "texture.glb"))
    first, second = (
        trimesh.load_mesh(io.BytesIO(mesh.glb), file_type="glb", process=False)
        for mesh in found.values()
    )
    assert np.allclose(first.bounds, box.bounds)
    assert (np.asarray(first.visual.vertex_colors) == [200, 30, 40, 255]).all()
    assert [mesh.color for mesh in found.values()] == [(200, 30, 40, 255), None]
    image = second.visual.material.baseColorTexture
    assert image.size == (mesh_files.TEXTURE, 20) and image.convert("RGB").getpixel((5, 5)) == (
        10,
        200,
        30,
    )
    assert np.allclose(second.visual.uv, uv, atol=1e-6)


def test_a_dae_mesh_without_its_reader_names_the_package(tmp_path, monkeypatch):
    (tmp_path / "x.dae").write_text("<COLLADA/>")
    monkeypatch.setattr(mesh_files.importlib.util, "find_spec", lambda name: None)
    assert "pip install 'pycollada" in read_meshes([(tmp_path / "x.dae", None)]).popitem()[1]


def test_sentences_are_html_letter_by_letter():
    assert Tags(live.format_html(EVIL.format(site="host"))).tags == [("p", "")]
    drawn = types.SimpleNamespace(lost=["a", "b", "c", "d", "e"])
    assert Drawn.lost_sentence.fget(drawn) == "5 meshes not drawn: a; b; c; and 2 more"

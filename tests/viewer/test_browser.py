"""The live viewer: its player without a browser, its page in headless Chromium, where there is one."""

import os
import re
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from io import BytesIO
from pathlib import Path
from urllib.request import urlopen

import imageio.v3 as imageio
import numpy as np
import pytest
from mujoco.studio import launch_thread, messages, sim, viewer_handle
from websockets.exceptions import ConnectionClosed, InvalidHandshake
from websockets.sync.client import connect

from armctl.viewer.browser import LOOPBACK, Player
from armctl.viewer.panel import Frame, Play, Seek, SetSpeed
from armctl.viewer.stage import Stage

ARMCTL = str(Path(sys.executable).parent / "armctl")


class Viewer:
    """The other end of a player: what Studio's thread would be."""

    def __init__(self, policy, env="armctl/ArmReach-v0"):
        self.end, other_end = launch_thread.make_thread_endpoints()
        self.player = Player(Stage(policy, env, seed=3))
        self.handle = viewer_handle.ViewerHandle(other_end, sim_plugins=[self.player])
        self.handle.set_model(self.player.scenery.model)
        self.frame = None

    def play(self, seconds=0.1):
        until = time.perf_counter() + seconds
        while time.perf_counter() < until:
            self.handle.sync()
        frames = [one for one in self.end.get_sim_snapshots() if isinstance(one, Frame)]
        self.frame = frames[-1] if frames else self.frame
        return self.frame.status

    def wish(self, *wishes, seconds=0.1):
        for wish in wishes:
            self.end.send_to_sim(wish)
        return self.play(seconds)


@pytest.mark.slow
def test_an_episode_takes_as_long_as_it_lasts():
    viewer = Viewer("random")
    viewer.play()
    before = viewer.frame.status.steps
    assert viewer.play(2.0).steps - before == pytest.approx(50, abs=5)
    assert viewer.handle.data.qpos.any()


def test_pause_step_again_and_next():
    viewer = Viewer("random")
    pause, go_on = (messages.RequestPauseEvent(sim.PauseState(paused)) for paused in (True, False))
    stopped = viewer.wish(pause)
    assert viewer.frame.paused
    assert viewer.play(0.3) == stopped
    assert viewer.wish(messages.SingleStepEvent()).steps == stopped.steps + 1
    assert viewer.wish(Play("random", 3, 0)).steps == 0
    status = viewer.wish(go_on, Play("random", 9, 4), seconds=0.3)
    assert (status.seed, status.episode) == (9, 4)
    assert status.steps > 2


def test_whoever_looks_back_sees_what_was_and_goes_on_from_where_it_was():
    viewer = Viewer("random")
    pause, go_on = (messages.RequestPauseEvent(sim.PauseState(paused)) for paused in (True, False))
    viewer.wish(*(messages.SingleStepEvent() for _ in range(6)), seconds=0.5)
    last, drawn = viewer.frame, viewer.handle.data.qpos.copy()
    assert (last.status.steps, last.last_step, last.paused) == (6, 6, True)
    assert viewer.wish(Seek(2)).steps == 2
    assert (viewer.frame.last_step, viewer.frame.paused) == (6, True)
    assert not np.array_equal(viewer.handle.data.qpos, drawn)
    assert viewer.frame.status.total_reward > last.status.total_reward
    assert [viewer.wish(Seek(step)).steps for step in (-5, 99)] == [0, 6]
    assert np.array_equal(viewer.handle.data.qpos, drawn)
    viewer.wish(Seek(3))
    assert viewer.wish(messages.SingleStepEvent()).steps == 7
    viewer.wish(Seek(1))
    assert viewer.wish(go_on, pause).steps >= 7
    assert viewer.wish(Play("random", 3, 1)).steps == viewer.frame.last_step == 0


@pytest.mark.slow
@pytest.mark.parametrize("speed", [0.25, 2.0])
def test_the_speed_is_that_many_times_real_time(speed):
    viewer = Viewer("random")
    viewer.wish(SetSpeed(speed))
    before = viewer.frame.status.steps
    assert viewer.frame.speed == speed
    assert viewer.play(1.0).steps - before == pytest.approx(25 * speed, abs=4)


@pytest.mark.slow
def test_the_next_episode_follows_and_another_policy_may_come_on():
    viewer = Viewer("reach_ik")
    assert viewer.play(4.0).episode == 1
    assert viewer.wish(Play("random", 3, 1)).policy == "random"
    status = viewer.wish(Play("bridge_ompl", 3, 1))
    assert (status.policy, viewer.frame.notice[:11]) == ("random", "bridge_ompl")
    viewer.wish(Play("random", 3, 2))
    assert viewer.frame.notice == ""


@pytest.mark.slow
@pytest.mark.parametrize("robot", ["ur3", "ur5", "panda"])
def test_the_first_view_is_of_the_workspace(robot):
    player = Player(Stage("random", "armctl/ArmReach-v0", env_options={"robot": robot}))
    model, reach = player.scenery.model, player.stage.task._workspace.radius
    view, stat = model.vis.global_, model.stat
    turn, tilt = np.radians((view.azimuth, view.elevation))
    ahead = np.array([np.cos(tilt) * np.cos(turn), np.cos(tilt) * np.sin(turn), np.sin(tilt)])
    up = np.array([-np.sin(tilt) * np.cos(turn), -np.sin(tilt) * np.sin(turn), np.cos(tilt)])
    eye = stat.center - 1.5 * stat.extent * ahead

    def height(point):
        """Of a point in the picture, from -1 at the bottom to 1 at the top."""
        return (point - eye) @ up / ((point - eye) @ ahead) / np.tan(np.radians(view.fovy) / 2)

    foot, top = height(np.zeros(3)), height(np.array([0.0, 0.0, reach]))
    assert -0.7 < foot < -0.2
    assert 0.2 < top < 1


def test_plans_are_drawn_and_no_other_model_is_let_in(tmp_path):
    viewer = Viewer("reach_mpc")
    viewer.play(0.3)
    assert viewer.frame.plans == ("horizon",)
    assert len(viewer.frame.geoms) > 10
    model = tmp_path / "other.xml"
    model.write_text("<mujoco/>")
    viewer.wish(messages.LoadModelEvent(path=str(model)))
    assert viewer.handle.model is viewer.player.scenery.model


@contextmanager
def viewing(tmp_path, *arguments):
    """`armctl view`, and its process and the address of its page once that is there; ended as with Ctrl-C."""
    command = [ARMCTL, "view", *arguments, "--no-open"]
    log = tmp_path / "log.txt"
    with log.open("w") as output, subprocess.Popen(command, stdout=output, stderr=output, cwd=tmp_path) as process:
        try:
            found = None
            while found is None:
                assert process.poll() is None, log.read_text()
                time.sleep(0.2)
                found = re.search(r"(http://localhost:(\d+)/\?token=.{32})\n", log.read_text())
            yield process, found[1], int(found[2])
        finally:
            process.send_signal(signal.SIGINT)
            code = process.wait(300)
    assert code == 130, log.read_text()
    assert "Traceback" not in log.read_text()


def answers(host, port):
    with socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET) as client:
        client.settimeout(5)
        return client.connect_ex((host, port)) == 0


def own_addresses():
    """Of this machine's interfaces, as far as its name tells, and a loopback address that only `0.0.0.0` answers."""
    named = {place[0] for *_, place in socket.getaddrinfo(socket.gethostname(), None, proto=socket.IPPROTO_TCP)}
    return {"127.0.0.2", *named} - {LOOPBACK}


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere 127.0.0.2 needs to be set up")
def test_the_page_answers_on_loopback_alone_and_a_taken_port_is_told(tmp_path):
    with viewing(tmp_path, "random") as (_, address, port):
        with urlopen(address) as page:
            content = page.read()
            assert b"web_client" in content
            assert re.search(rb"<title>armctl *</title>", content)
        assert [address for address in own_addresses() if answers(address, port)] == []
        said = (tmp_path / "log.txt").read_text()
        assert f"The page, for this machine only: {address}\n" in said
        assert len(said.splitlines()) == 2  # nothing of the server's
        again = subprocess.run([ARMCTL, "view", "random", "--port", str(port)], capture_output=True, text=True)
    assert again.returncode == 2
    assert f"port {port}" in again.stderr
    with socket.socket() as public:  # what the addresses above do answer to
        public.bind(("0.0.0.0", 0))
        public.listen()
        assert answers("127.0.0.2", public.getsockname()[1])


@pytest.mark.slow
def test_a_window_without_a_screen_is_a_clear_error(tmp_path):
    blind = {name: value for name, value in os.environ.items() if name not in ("DISPLAY", "WAYLAND_DISPLAY")}
    done = subprocess.run([ARMCTL, "view", "random", "--native"], capture_output=True, text=True, env=blind)
    assert (done.returncode, "needs a display" in done.stderr) == (2, True)


def picture(page):
    """What the page shows of the world, beside the panel, (height, width, 3)."""
    return imageio.imread(BytesIO(screenshot(page)))[:-20, 190:, :3].astype(int)


def screenshot(page, attempts=20):
    """A PNG; Chromium that renders in software sometimes says that it cannot take one, and can a moment later."""
    from playwright.sync_api import Error

    for _ in range(attempts - 1):
        try:
            return page.screenshot(timeout=120_000)
        except Error as error:
            if "Unable to capture screenshot" not in str(error):
                raise
        page.wait_for_timeout(500)
    return page.screenshot(timeout=120_000)


def changed(before, now):
    """Part of a picture that another one shows otherwise."""
    return (np.abs(now - before).max(axis=2) > 30).mean()


def stands_still(page):
    """For longer than between two episodes."""
    before = picture(page)
    page.wait_for_timeout(3000)
    return changed(before, picture(page)) < 1e-4


def eventually(page, holds, seconds=200):
    """Whether something comes to hold: a browser that renders in software can be late by many seconds."""
    until = time.monotonic() + seconds
    while not (held := holds()) and time.monotonic() < until:
        page.wait_for_timeout(500)
    return held


def memory(process):
    """Bytes that a process holds."""
    return int(re.search(r"VmRSS:\s+(\d+) kB", Path(f"/proc/{process.pid}/status").read_text())[1]) * 1024


def uploads(port, token, sid, size):
    """Drop a model onto the page; what is not taken is not sent."""
    address = f"ws://localhost:{port}/drop?sid={sid}&token={token}"
    with suppress(InvalidHandshake, ConnectionClosed), connect(address, proxy=None) as drop:
        drop.send(struct.pack("<I", 5) + b"a.xml" + bytes(size))
        drop.send(b"")
        drop.recv(timeout=60)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_uploads_and_long_messages_do_not_fill_the_memory(tmp_path):
    with viewing(tmp_path, "random") as (process, address, port):
        token = address.partition("=")[2]
        with connect(f"ws://localhost:{port}/ui?sid=me&token={token}", proxy=None) as panel:
            before = memory(process)
            for _ in range(24):
                uploads(port, token, "me", 2**26 - 9)
            with suppress(ConnectionClosed):
                for _ in range(24):
                    panel.send(bytes(2**26))
            assert memory(process) - before < 2**26


@pytest.mark.slow
def test_pages_that_are_closed_while_states_are_sent_leave_the_terminal_clean(tmp_path):
    with viewing(tmp_path, "random") as (_, address, port):
        token = address.partition("=")[2]

        def reload(page):
            for visit in range(60):
                with connect(f"ws://localhost:{port}/state?sid={page}&token={token}", proxy=None) as states:
                    states.recv(timeout=60)
                    time.sleep(0.001 * (visit % 20))

        with ThreadPoolExecutor(6) as pages:
            list(pages.map(reload, range(6)))


@pytest.mark.slow
@pytest.mark.browser
def test_the_robot_moves_on_the_page_and_no_request_leaves_the_machine(chromium, tmp_path):
    addresses = []
    with viewing(tmp_path, "reach_mpc", "--env", "armctl/ArmReachMoving-v0") as (_, address, port):
        page = chromium.new_page(viewport={"width": 800, "height": 500}, device_scale_factor=0.5)
        page.on("request", lambda request: addresses.append(request.url))
        page.on("websocket", lambda connection: addresses.append(connection.url))
        page.goto(address, wait_until="commit", timeout=120_000)
        assert eventually(page, lambda: picture(page).std() > 15)
        first = picture(page)
        assert eventually(page, lambda: changed(first, picture(page)) > 0.005)
        page.mouse.click(700, 400)
        page.keyboard.down("Space")
        assert eventually(page, lambda: stands_still(page))
        page.close()
    assert any(address.startswith("ws://") for address in addresses)
    assert [address for address in addresses if not re.match(rf"(http|ws)://localhost:{port}/", address)] == []


ATTACK = """
async ([port, path]) => new Promise(tell => {
  const socket = new WebSocket(`ws://localhost:${port}${path}`)
  socket.onopen = () => tell("open")
  socket.onerror = () => tell("refused")
})
"""


@pytest.mark.slow
@pytest.mark.browser
def test_another_page_in_the_same_browser_gets_nothing(chromium, tmp_path):
    with (
        viewing(tmp_path, "random") as (_, address, port),
        ThreadingHTTPServer((LOOPBACK, 0), SimpleHTTPRequestHandler) as other,
    ):
        threading.Thread(target=other.serve_forever).start()
        try:
            context = chromium.new_context()
            own = context.new_page()
            own.goto(address, wait_until="commit", timeout=120_000)
            assert own.evaluate(ATTACK, [port, "/state?sid=own"]) == "open"
            assert own.evaluate("async () => (await fetch('/model')).status") == 200  # by the cookie
            strange = context.new_page()
            strange.goto(f"http://localhost:{other.server_port}/nothing")  # the same site, so that the cookie is sent
            for path in ("/ui?sid=it", "/state?sid=it", "/drop?sid=it"):
                assert strange.evaluate(ATTACK, [port, path]) == "refused"
            fetched = "async port => fetch(`http://localhost:${port}/model`).then(() => 'read', () => 'refused')"
            assert strange.evaluate(fetched, port) == "refused"
            context.close()
        finally:
            other.shutdown()

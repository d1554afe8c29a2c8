"""The page of the report in headless Chromium."""

import re

import pytest

from armctl.report import write_report

from .pages import plots_of


def look_at_the_switches(tab):
    """The theme follows the system and its switch, which is remembered; the profile shows all when asked to."""
    paper = "getComputedStyle(document.querySelector('section')).backgroundColor"
    ink = "document.querySelector('.canvas .xtick text').style.fill"
    theme = tab.locator("#theme")
    tab.emulate_media(color_scheme="dark")
    tab.wait_for_function(f"() => {ink} === 'rgb(230, 234, 238)'")
    assert (tab.evaluate(paper), theme.inner_text()) == ("rgb(23, 28, 33)", "Light")
    theme.click()
    tab.wait_for_function(f"() => {ink} === 'rgb(31, 41, 51)'")
    assert (tab.evaluate(paper), theme.inner_text()) == ("rgb(255, 255, 255)", "Dark")
    tab.reload()
    tab.wait_for_function("() => document.getElementById('theme').textContent === 'Dark'")
    assert tab.evaluate(paper) == "rgb(255, 255, 255)"
    tab.emulate_media(color_scheme="light")
    tab.wait_for_function("() => document.querySelectorAll('.canvas .main-svg').length > 0")
    shown = "document.querySelector('button.axis').closest('.plot').querySelector('.canvas').layout.xaxis.range[0]"
    least = tab.evaluate(shown)
    tab.locator("button.axis").click()
    assert tab.evaluate(shown) < least - 50
    tab.locator("button.axis").click()
    assert tab.evaluate(shown) == least
    for player in tab.locator(".clip.playable").all():
        assert player.locator("video").get_attribute("controls") is None
        assert player.locator("button").bounding_box()["y"] >= sum(
            player.locator("video").bounding_box()[edge] for edge in ("y", "height")
        )


@pytest.fixture(scope="module")
def report(finished_sweep, tmp_path_factory):
    return write_report(finished_sweep, tmp_path_factory.mktemp("page") / "report.html")


@pytest.mark.slow
@pytest.mark.browser
@pytest.mark.parametrize("width", [1280, 390])
def test_the_page_in_a_browser(chromium, report, width):
    assert report.stat().st_size < 15e6
    requests, complaints = [], []
    tab = chromium.new_page(viewport={"width": width, "height": 844})
    tab.on("request", lambda request: requests.append(request.url))
    tab.on("console", lambda message: complaints.append(message.text))
    tab.on("pageerror", lambda error: complaints.append(str(error)))
    tab.goto(report.as_uri(), timeout=120_000)
    drawn = "() => [...document.querySelectorAll('.canvas')].every(canvas => canvas.querySelector('.trace, .point'))"
    tab.wait_for_function(drawn, timeout=120_000)
    assert tab.locator(".canvas").count() == len(plots_of(report)) == 11
    assert tab.evaluate("document.documentElement.scrollWidth") <= width
    beyond = "[...document.querySelectorAll('section, .wide')].filter(one => one.scrollWidth > one.clientWidth).length"
    assert tab.evaluate(beyond) == 0
    clips = tab.locator("video")
    if clips.count():
        tab.wait_for_function("() => [...document.querySelectorAll('video')].every(clip => clip.duration > 0.5)")
        tab.locator(".together").scroll_into_view_if_needed()
        tab.wait_for_function("() => document.querySelector('video').currentTime > 0.2")
        shown = tab.evaluate("[...document.querySelectorAll('.together video')].map(clip => clip.currentTime)")
        assert max(shown) - min(shown) < 0.5
    else:
        assert "OpenGL" in tab.locator("body").inner_text()
    look_at_the_switches(tab)
    wide = "[...document.querySelectorAll('.canvas .main-svg')].map(svg => svg.getBoundingClientRect().width)"
    tab.evaluate("dispatchEvent(new Event('beforeprint'))")
    assert max(tab.evaluate(wide)) <= 680
    tab.evaluate("dispatchEvent(new Event('afterprint'))")
    pdf = tab.pdf(prefer_css_page_size=True)
    assert pdf.startswith(b"%PDF")
    assert 3 <= len(re.findall(rb"/Type\s*/Page\b", pdf)) <= 12
    assert {url for url in requests if not url.startswith("data:")} == {report.as_uri()}
    assert complaints == []

"""A browser without a window, where there is one: Chromium, driven by Selenium; and the rules of axe."""

import shutil
from importlib import resources

import pytest

WIDTHS = (390, 768, 1280)  # px: a phone, a tablet, a screen
GRAVE = ("serious", "critical")
WIDER = """
const width = document.documentElement.clientWidth;
return [...document.querySelectorAll("body *")].filter(one => !one.closest(".scroll, .plot, .unseen, .skip")
  && one.getBoundingClientRect().width && one.getBoundingClientRect().right > width + 1).map(one => one.outerHTML);
"""
AXE = (
    "const done = arguments[0]; axe.run(document, {resultTypes: ['violations']}).then(found => done(found.violations))"
)


def started():
    """Chromium; skips the test where it, or what drives it, is missing."""
    webdriver = pytest.importorskip("selenium.webdriver", reason="no Selenium: pip install 'diffdrive[pages]'")
    binary, driver = shutil.which("chromium") or shutil.which("google-chrome"), shutil.which("chromedriver")
    if binary is None or driver is None:
        pytest.skip("no Chromium with its chromedriver")
    options = webdriver.ChromeOptions()
    options.binary_location = binary
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    for one in ("--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--hide-scrollbars"):
        options.add_argument(one)
    return webdriver.Chrome(options=options, service=webdriver.ChromeService(driver))


def opened(browser, path, width=1280, scheme="light"):
    """Open a page on a screen so wide, light or dark, and wait until it is drawn."""
    features = [{"name": "prefers-color-scheme", "value": scheme}]
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": features})
    screen = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": width < 500}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", screen)
    browser.get(path.as_uri())
    browser.execute_async_script("const done = arguments[0]; requestAnimationFrame(() => setTimeout(done, 100))")


def complaints(browser):
    """What the browser wrote to its console: errors, and what the page's policy has blocked."""
    return [one["message"] for one in browser.get_log("browser")]


def violations(browser):
    """The grave findings of axe on the page that is open."""
    axe = pytest.importorskip("axe_core_python", reason="no axe: pip install 'diffdrive[pages]'")
    browser.execute_script((resources.files(axe) / "axe.min.js").read_text(encoding="utf-8"))
    return [(one["id"], one["nodes"][0]["html"]) for one in browser.execute_async_script(AXE) if one["impact"] in GRAVE]

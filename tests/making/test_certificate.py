# SPDX-License-Identifier: Apache-2.0
"""The certificate of a map: what it says follows from where photos are localized."""

from __future__ import annotations

import json
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from scenes import ROOM_POSE, room, room_camera, room_map

from gscpe.errors import MapError, SettingsError
from gscpe.geometry import se3
from gscpe.making import (
    Certificate,
    CertificateSettings,
    CertifiedPhoto,
    certify,
    photo_table,
    read_certificate,
    summary_table,
    write_certificate_page,
)
from gscpe.photos import write_image
from gscpe.scene import References, open_map, save_map
from gscpe.scene.map_folder import CERTIFICATE, CERTIFICATE_PAGE

CAMERA = room_camera(240, 180)


@pytest.fixture(scope="module")
def certified(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Certificate]:
    """A map folder with the certificate of two photos of the room, and of one of another room."""
    root = tmp_path_factory.mktemp("certified")
    poses = [se3.exp([0.04 * i, 0.02, 0, 0.01, 0.02 * i, 0]) @ ROOM_POSE for i in (-1, 1)]
    shots = [room().shoot(CAMERA, pose).uint8 for pose in poses]
    poses.append(ROOM_POSE)
    shots.append(room(3).shoot(CAMERA, ROOM_POSE).uint8)
    names = ("left.png", "right.png", "elsewhere.png")
    for name, shot in zip(names, shots, strict=True):
        write_image(root / name, shot)
    folder = root / "room.gsmap"
    save_map(room_map(), folder)
    left_out = References(names, np.stack(poses), (CAMERA,) * 3)
    certificate, images = certify(open_map(folder), left_out, root, matcher="sift")
    assert list(images) == ["elsewhere.png", *(p.name for p in certificate.worst_first()[1:])]
    (folder / CERTIFICATE).write_text(certificate.to_json())
    write_certificate_page(folder / CERTIFICATE_PAGE, "<room>", certificate, images, {"a": "b"})
    return folder, certificate


def test_photos_are_localized_and_compared(certified: tuple[Path, Certificate]) -> None:
    _, certificate = certified
    by_name = {photo.name: photo for photo in certificate.photos}
    assert certificate.localized == pytest.approx(2 / 3)
    assert by_name["elsewhere.png"].reason is not None
    assert by_name["elsewhere.png"].distance is None
    for name in ("left.png", "right.png"):
        photo = by_name[name]
        assert photo.distance is not None and photo.degrees is not None
        assert photo.distance < 0.01
        assert photo.degrees < 0.3
        assert photo.psnr > by_name["elsewhere.png"].psnr + 3
        assert photo.fitted_psnr >= photo.psnr - 1e-4
        assert photo.ssim > by_name["elsewhere.png"].ssim
    # One reference beside them: what is seen is farther than photos are apart.
    assert 1.0 < certificate.scene_size < 3.0
    assert certificate.verdict == "usable"
    assert "2 of the 3 photos" in certificate.explanation()
    assert "say little" in certificate.explanation()


def test_it_is_kept_in_the_map_and_read_again(certified: tuple[Path, Certificate]) -> None:
    folder, certificate = certified
    assert read_certificate(folder) == certificate
    assert json.loads((folder / CERTIFICATE).read_text())["verdict"] == "usable"
    assert len(open_map(folder).references) == 1, "the map is opened without it"


def test_a_map_with_a_certificate_is_replaced_whole(
    certified: tuple[Path, Certificate], tmp_path: Path
) -> None:
    _, certificate = certified
    folder = tmp_path / "new.gsmap"
    save_map(room_map(), folder)
    (folder / CERTIFICATE).write_text(certificate.to_json())
    (folder / CERTIFICATE_PAGE).write_text("page")
    save_map(room_map(), folder)
    assert read_certificate(folder) is None, "the new map is not what the old one was"
    for damaged in ("{}", json.dumps(json.loads(certificate.to_json()) | {"seen": "much"})):
        (folder / CERTIFICATE).write_text(damaged)
        with pytest.raises(MapError, match="damaged"):
            read_certificate(folder)


def test_the_page_needs_nothing_and_escapes_names(certified: tuple[Path, Certificate]) -> None:
    folder, _ = certified
    text = (folder / CERTIFICATE_PAGE).read_text()
    assert "<room>" not in text and "&lt;room&gt;" in text

    class Pictures(HTMLParser):
        sources: list[str]
        ids: set[str]
        links: set[str]

        def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
            named = dict(attrs)
            if tag == "img":
                self.sources.append(named["src"] or "")
            self.ids |= {named.get("id") or ""}
            self.links |= {named["href"] or ""} if tag == "a" else set()

    parser = Pictures()
    parser.sources, parser.ids, parser.links = [], set(), set()
    parser.feed(text)
    assert len(parser.sources) == 9, "photo, render and difference of three"
    assert all(source.startswith("data:image/webp;base64,") for source in parser.sources)
    assert {link.removeprefix("#") for link in parser.links} <= parser.ids
    assert "://" not in text


def certificate_of(
    localized: int, count: int, distance: float, degrees: float = 0.1
) -> Certificate:
    found = CertifiedPhoto("a", None, distance, degrees, 20.0, 22.0, 0.7)
    lost = replace(found, reason="too few matches", distance=None, degrees=None)
    photos = (found,) * localized + (lost,) * (count - localized)
    return Certificate(photos, 10.0, None, 70, 1000, CertificateSettings())


@pytest.mark.parametrize(
    ("localized", "distance", "degrees", "verdict"),
    [
        (10, 0.02, 0.1, "good"),
        (9, 0.005, 0.1, "good"),
        (8, 0.005, 0.1, "usable"),
        (10, 0.021, 0.1, "usable"),
        (10, 0.01, 0.5, "usable"),
        (5, 0.005, 0.1, "poor"),
        (10, 0.2, 0.1, "poor"),
        (0, 0.0, 0.0, "poor"),
    ],
)
def test_verdicts(localized: int, distance: float, degrees: float, verdict: str) -> None:
    certificate = certificate_of(localized, 10, distance, degrees)
    assert certificate.verdict == verdict
    assert f"The map is {verdict}" in certificate.explanation()
    json.loads(certificate.to_json())  # NaN is no JSON
    assert photo_table(certificate).rows and summary_table(certificate).rows


def test_shares_within() -> None:
    assert certificate_of(9, 10, 0.019).within(0.002) == pytest.approx(0.9)
    assert certificate_of(9, 10, 0.021).within(0.002) == 0.0


def test_impossible_settings_and_no_photos() -> None:
    with pytest.raises(SettingsError):
        CertificateSettings(good_localized=0.5, usable_localized=0.6)
    with pytest.raises(SettingsError):
        CertificateSettings(good_error=0.02)
    nothing = References((), np.zeros((0, 4, 4)), ())
    with pytest.raises(MapError, match="not made of"):
        certify(room_map(), nothing, ".")

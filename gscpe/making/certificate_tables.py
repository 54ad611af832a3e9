# SPDX-License-Identifier: Apache-2.0
"""A certificate as tables."""

from __future__ import annotations

from dataclasses import asdict

from gscpe.evaluation.table import Table
from gscpe.evaluation.text import degrees_text, length_text, number_text, share_text
from gscpe.making.certificate import Certificate


def summary_table(certificate: Certificate) -> Table:
    """The numbers of the whole."""
    renders = certificate.of_renders
    rows = [
        ("renders" if renders else "photos left out", str(len(certificate.photos))),
        ("localized", share_text(certificate.localized)),
        ("median position error", certificate.length(certificate.median_distance)),
        ("... of the scene's size", f"{number_text(100 * certificate.relative_error, 3)}%"),
        ("median rotation error", degrees_text(certificate.median_degrees)),
        ("within 0.2% of the scene's size", share_text(certificate.within(0.002))),
        ("scene's size", certificate.length(certificate.scene_size)),
    ]
    if not renders:
        rows += [
            ("PSNR", f"{number_text(certificate.mean('psnr'), 2)} dB"),
            ("... with exposure fitted", f"{number_text(certificate.mean('fitted_psnr'), 2)} dB"),
            ("SSIM", number_text(certificate.mean("ssim"), 3)),
        ]
    rows += [
        (
            "virtual references" if renders else "photos that the map is made of",
            str(certificate.learned),
        ),
        ("Gaussians", str(certificate.gaussians)),
    ]
    return Table("Certificate", ("", "value"), tuple(rows), words=("value",))


def photo_table(certificate: Certificate) -> Table:
    """A row a photo, the worst first."""
    rows, records = [], []
    for photo in certificate.worst_first():
        distance = None if photo.distance is None else photo.distance * certificate.length_unit
        rows.append(
            (
                photo.name,
                length_text(distance, certificate.metres_per_unit is not None),
                degrees_text(photo.degrees),
                number_text(photo.psnr, 2),
                number_text(photo.fitted_psnr, 2),
                number_text(photo.ssim, 3),
                photo.reason or "localized",
            )
        )
        records.append(asdict(photo))
    return Table(
        "Photos that the map was not made of",
        ("photo", "position error", "rotation error", "PSNR", "fitted", "SSIM", "result"),
        tuple(rows),
        records=tuple(records),
        words=("result",),
        tips={
            "PSNR": "of photo and render at the pose where structure from motion placed it, dB",
            "fitted": "PSNR with a gain and a bias fitted to each channel, dB",
        },
    )

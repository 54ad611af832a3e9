# SPDX-License-Identifier: Apache-2.0
"""Maps from photos or a video, in one go, and how good they are."""

from gscpe.making.certificate import (
    Certificate,
    CertifiedPhoto,
    read_certificate,
    write_certificate,
)
from gscpe.making.certificate_page import write_certificate_page
from gscpe.making.certificate_tables import photo_table, summary_table
from gscpe.making.certify import certify
from gscpe.making.certify_virtual import certify_virtual
from gscpe.making.from_photos import MadeMap, make_map, work_folder_of
from gscpe.making.settings import CertificateSettings, MakeMapSettings
from gscpe.reconstruction.known_poses import KnownPoses

__all__ = [
    "Certificate",
    "CertificateSettings",
    "CertifiedPhoto",
    "KnownPoses",
    "MadeMap",
    "MakeMapSettings",
    "certify",
    "certify_virtual",
    "make_map",
    "photo_table",
    "read_certificate",
    "summary_table",
    "work_folder_of",
    "write_certificate",
    "write_certificate_page",
]

"""Certificates of an authority made here, for hosts with mutual TLS.

Importable from every test: `from certificates import make_certificate`.
"""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

__all__ = ["make_certificate"]

_KEY = "-newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -noenc"


def make_certificate(folder: Path, name: str, authority: str, trusts: str | None = None) -> Path:
    """Return the Zenoh configuration of a host, with a certificate that an authority has signed.

    The host trusts the same authority, or `trusts`.
    """

    def openssl(command: str) -> None:
        subprocess.run(["openssl", *command.split()], cwd=folder, check=True, capture_output=True)

    if not (folder / f"{authority}.pem").exists():
        openssl(f"req -x509 {_KEY} -keyout {authority}.key -out {authority}.pem -days 2 "
                f"-subj /CN={authority}")  # fmt: skip
    openssl(f"req -x509 {_KEY} -keyout {name}.key -out {name}.pem -days 2 -subj /CN={name} "
            f"-CA {authority}.pem -CAkey {authority}.key "
            "-addext basicConstraints=critical,CA:FALSE "
            "-addext subjectAltName=DNS:localhost,IP:127.0.0.1")  # fmt: skip
    tls = {
        "root_ca_certificate": str(folder / f"{trusts or authority}.pem"),
        "enable_mtls": True,
        **{
            f"{side}_{what}": str(folder / f"{name}.{ending}")
            for side in ("listen", "connect")
            for what, ending in (("private_key", "key"), ("certificate", "pem"))
        },
    }
    config = folder / f"{name}.json5"
    config.write_text(json.dumps({"transport": {"link": {"tls": tls}}}))
    return config

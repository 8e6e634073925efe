"""The name in a certificate, as OpenSSL writes it."""

from __future__ import annotations

import base64
import json
import subprocess
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from llfsm.whiteboard import NetworkError
from llfsm.whiteboard.mirror.settings import Settings
from llfsm.whiteboard.mirror.zenoh_config import certificate_name, common_name, configure
from programs import program

from .conftest import Certify


def certificate(folder: Path, subject: str) -> str:
    program("openssl")
    command = ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt",
               "ec_paramgen_curve:prime256v1", "-noenc", "-keyout", "key", "-utf8", "-subj",
               subject]  # fmt: skip
    return subprocess.run(command, cwd=folder, check=True, capture_output=True, text=True).stdout


@pytest.mark.parametrize(
    ("subject", "name"),
    [
        ("/CN=robot", "robot"),
        ("/C=AU/O=Ours/OU=Lab/CN=robot.local", "robot.local"),
        ("/O=Ours/CN=first/CN=second", "first"),
        ("/CN=Größe 3", "Größe 3"),
        (f"/O={'x' * 60}/OU={'y' * 60}/CN={'z' * 64}", "z" * 64),
        ("/O=Ours", None),
    ],
)
def test_the_name_is_the_subjects(tmp_path: Path, subject: str, name: str | None) -> None:
    pem = certificate(tmp_path, subject)
    assert common_name(pem) == name
    assert common_name(f"any text\n{pem}{certificate(tmp_path, '/CN=issuer')}") == name


def test_a_text_without_a_certificate_is_an_error(tmp_path: Path) -> None:
    pem = certificate(tmp_path, "/CN=robot")
    key = (tmp_path / "key").read_text()
    short = base64.b64encode(base64.b64decode("".join(pem.split("\n")[1:-2]))[:90]).decode()
    begin, end = "-----BEGIN CERTIFICATE-----", "-----END CERTIFICATE-----"
    for text in ("", key, f"{begin}\n{short}\n{end}", f"{begin}\n%\n{end}"):
        with pytest.raises(ValueError, match="not a certificate"):
            common_name(text)


@given(data=st.binary(max_size=60))
def test_no_bytes_do_harm(data: bytes) -> None:
    body = base64.encodebytes(data).decode()
    with pytest.raises(ValueError, match="not a certificate"):
        common_name(f"-----BEGIN CERTIFICATE-----\n{body}-----END CERTIFICATE-----\n")


def test_a_host_is_called_as_its_certificate(certify: Certify, tmp_path: Path) -> None:
    config = certify("robot", "ours")
    assert certificate_name(configure(Settings(zenoh=str(config)), "peer")) == "robot"
    assert certificate_name(configure(Settings(), "peer")) == "-"
    tls = json.loads(config.read_text())["transport"]["link"]["tls"]
    pem = Path(tls["connect_certificate"]).read_bytes()
    encoded = {"listen_certificate_base64": base64.b64encode(pem).decode()}
    config.write_text(json.dumps({"transport": {"link": {"tls": encoded}}}))
    assert certificate_name(configure(Settings(zenoh=str(config)), "peer")) == "robot"
    odd = tmp_path / "odd.pem"
    odd.write_text(certificate(tmp_path, "/CN=*.local"))
    config.write_text(
        json.dumps({"transport": {"link": {"tls": {"listen_certificate": str(odd)}}}})
    )
    assert certificate_name(configure(Settings(zenoh=str(config)), "peer")) == "-"
    odd.unlink()
    with pytest.raises(NetworkError, match=r"odd\.pem: .*No such file"):
        certificate_name(configure(Settings(zenoh=str(config)), "peer"))

# SPDX-License-Identifier: Apache-2.0
"""A router accepts only nodes with a certificate, and a node trusts only its own router."""

import shutil
import subprocess

import pytest
from tests.peers.ros2_zenoh.zenoh_rig import Tokens, peer, running, until
from tests.peers.ros2_zenoh.zenoh_router import free_port, router

from motord.bus.ros2.zenoh.node import Router, ZenohNode

pytestmark = pytest.mark.skipif(not shutil.which("openssl"), reason="apt install openssl")

KEY = ("-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes")


def certified(folder):
    """Make a certificate authority in `folder`, and its certificates for router and node."""

    def openssl(*words):
        subprocess.run(["openssl", *words], check=True, cwd=folder, capture_output=True, timeout=60)

    openssl("req", "-x509", *KEY, "-keyout", "ca.key", "-out", "ca.pem", "-subj", "/CN=test CA",
            "-days", "2")  # fmt: skip
    (folder / "names").write_text("subjectAltName=DNS:localhost\n", encoding="ascii")
    for who in ("router", "node"):
        openssl("req", *KEY, "-keyout", f"{who}.key", "-out", f"{who}.csr", "-subj", f"/CN={who}")
        openssl("x509", "-req", "-in", f"{who}.csr", "-CA", "ca.pem", "-CAkey", "ca.key", "-days",
                "2", "-CAcreateserial", "-out", f"{who}.pem", "-extfile", "names")  # fmt: skip


def node(name, port, authority, own=None):
    router = Router(
        endpoint=f"tls/localhost:{port}",
        ca_file=str(authority / "ca.pem"),
        cert_file=str(own / "node.pem") if own else None,
        key_file=str(own / "node.key") if own else None,
    )
    return ZenohNode(name, "/r2", 3, router)


@pytest.fixture(scope="module")
def authorities(tmp_path_factory):
    folders = [tmp_path_factory.mktemp(name) for name in ("ours", "theirs")]
    for folder in folders:
        certified(folder)
    return folders


async def test_a_node_connects_only_with_a_certificate(authorities, caplog):
    ours, theirs = authorities
    plain, tls = free_port(), free_port()
    async with router(plain, tls, ours):
        with peer(plain) as session:
            tokens = Tokens(session)
            strangers = {
                "bare": node("bare", tls, ours),
                "foreign": node("foreign", tls, ours, theirs),
                "misled": node("misled", tls, theirs, ours),
            }
            for stranger in strangers.values():
                async with running(stranger):
                    caplog.clear()
                    await until(lambda: "no router at tls/localhost" in caplog.text)
            async with running(node("known", tls, ours, ours)):
                await until(lambda: tokens.of("NN"))
                assert [token.rsplit("/", 1)[1] for token in tokens.of("NN")] == ["known"]
            assert not [token for token in tokens.gone if not token.endswith("/known")]

# SPDX-License-Identifier: Apache-2.0
"""The token of the inputs that tests send commands to."""

TOKEN = "a-token-of-sixteen-and-more"


def token_file(folder):
    path = folder / "token"
    path.write_text(TOKEN + "\n", encoding="utf-8")
    path.chmod(0o600)
    return path

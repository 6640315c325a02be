# SPDX-License-Identifier: Apache-2.0
"""Log and start-up of any process; imports nothing else of ours."""

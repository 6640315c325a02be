# SPDX-License-Identifier: Apache-2.0
"""Serial ports: found, opened for ourselves alone, set up, and their transceivers turned."""

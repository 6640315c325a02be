# SPDX-License-Identifier: Apache-2.0
"""Rules for what has to fit together in a robot file."""

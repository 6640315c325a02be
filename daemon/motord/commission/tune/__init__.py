# SPDX-License-Identifier: Apache-2.0
"""The speed loop from a recorded step: motord tune."""

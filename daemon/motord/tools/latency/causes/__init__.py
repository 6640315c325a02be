# SPDX-License-Identifier: Apache-2.0
"""What made ticks late."""

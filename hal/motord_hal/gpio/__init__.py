# SPDX-License-Identifier: Apache-2.0
"""GPIO lines by the kernel's character device: chips by label, lines by name."""

# SPDX-License-Identifier: Apache-2.0
"""Work for pages that runs in processes of its own."""

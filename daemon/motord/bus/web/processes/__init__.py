# SPDX-License-Identifier: Apache-2.0
"""What pages have done by processes of their own."""

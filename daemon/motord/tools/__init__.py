# SPDX-License-Identifier: Apache-2.0
"""What measures and shows motord: nothing here runs inside the daemon."""

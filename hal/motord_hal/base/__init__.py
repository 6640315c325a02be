# SPDX-License-Identifier: Apache-2.0
"""Clock, errors, back-off and files; imports nothing else of ours."""

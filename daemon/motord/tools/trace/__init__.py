# SPDX-License-Identifier: Apache-2.0
"""`motord trace`: the bytes on a line, decoded by the profiles, and as files for other tools."""

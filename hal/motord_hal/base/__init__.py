# SPDX-License-Identifier: Apache-2.0
"""Clock, errors, back-off and files. It imports no other package of motord."""

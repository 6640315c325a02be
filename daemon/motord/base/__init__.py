# SPDX-License-Identifier: Apache-2.0
"""Log and start-up of any process. This package imports no other one of motord."""

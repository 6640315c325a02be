# SPDX-License-Identifier: Apache-2.0
"""What any long-lived process needs: log, supervisor, readiness, limits."""

# SPDX-License-Identifier: Apache-2.0
# Only for type checkers. api_bus.h describes the names; cffi checks their types at run time.
from typing import Any

ffi: Any
lib: Any

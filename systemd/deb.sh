#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# deb.sh DIR: makes DIR/motord_VERSION_ARCH.deb for the Debian that this runs on, and prints its
# path. The package carries its Python packages in an environment of its own, /usr/lib/motord:
# installing it takes nothing from a network. A package that is there is kept as long as none of its
# sources has changed.
set -euo pipefail

here=$(dirname "$(realpath "$0")")
project=$(dirname "$here")
mkdir -p "$1"
dir=$(realpath "$1")
python=$project/.venv/bin/python
of_project() { # KEY of [project] in pyproject.toml: its value, a list one a line
    "$python" - "$project/pyproject.toml" "$1" <<'CODE'
import sys, tomllib
with open(sys.argv[1], "rb") as file:
    value = tomllib.load(file)["project"][sys.argv[2]]
print(value if isinstance(value, str) else "\n".join(value))
CODE
}
version=$(of_project version)
architecture=$(dpkg --print-architecture)
minor_of() { "$1" -c 'import sys; print("%d.%d" % sys.version_info[:2])'; }
minor=$(minor_of /usr/bin/python3)
next=${minor%.*}.$((${minor#*.} + 1))
root=$dir/root
home=$root/usr/lib/motord
packages=$home/lib/python$minor/site-packages
pip=("$python" -m pip --quiet --disable-pip-version-check install --no-compile --no-warn-conflicts
    --target)

[ "$(minor_of "$python")" = "$minor" ] || {
    echo "deb: .venv has another Python than /usr/bin/python3 ($minor)," \
        "for which the package is made" >&2
    exit 1
}

package=$dir/motord_${version}_$architecture.deb
sources=("$project"/{config,csrc,daemon,hal,systemd,setup.py,pyproject.toml,README.md,LICENSE})
state=$(find "${sources[@]}" -type f \
    -not -name '*.pyc' -not -name '*.so' -not -path '*.egg-info/*' \
    -printf '%p %s %T@\n' | LC_ALL=C sort)
if [ -f "$package" ] && [ "$(cat "$dir/made.txt" 2>/dev/null)" = "$state" ]; then
    echo "$package"
    exit
fi

# The dependencies take longest and change least: kept as long as pyproject.toml asks for the same.
wanted=$(of_project dependencies)
if [ "$(cat "$dir/others.txt" 2>/dev/null)" != "$wanted" ]; then
    rm -rf "$dir/others" "$dir/others.txt"
    mapfile -t names <<<"$wanted"
    "${pip[@]}" "$dir/others" "${names[@]}" >&2
    echo "$wanted" >"$dir/others.txt"
fi

rm -rf "$root" "$dir/made.txt"
install -d "$root"/{DEBIAN,etc/motord} \
    "$root"/usr/{bin,lib/sysusers.d,share/{doc/motord,motord/robots}} \
    "$home/bin" "${packages%/*}" "$root"/lib/{systemd/system,udev/rules.d}
cp -a "$dir/others" "$packages"
# from a copy: what an older build has left beside the sources must not come along
rm -rf "$dir/source"
install -d "$dir/source"
cp -a "$project"/{config,csrc,daemon,hal,setup.py,pyproject.toml,README.md,LICENSE} "$dir/source/"
"${pip[@]}" "$packages" --upgrade --no-deps --no-build-isolation "$dir/source" >&2
rm -rf "$packages/bin"
ln -s /usr/bin/python3 "$home/bin/python3"
printf 'home = /usr/bin\ninclude-system-site-packages = false\nversion = %s\n' "$minor" \
    >"$home/pyvenv.cfg"
install -m 755 "$here/deb/motord" "$root/usr/bin/motord"
# compiled here, and never judged by a time stamp: nothing is written where the package is installed
"$python" -m compileall -q --invalidation-mode unchecked-hash -s "$root" "$packages" >&2

install -m 644 "$project"/systemd/motord@.service "$root/lib/systemd/system/"
install -m 644 "$project"/systemd/*.rules "$root/lib/udev/rules.d/"
install -m 644 "$project"/systemd/sysusers.conf "$root/usr/lib/sysusers.d/motord.conf"
install -m 644 "$project"/config/robots/*.toml "$root/usr/share/motord/robots/"
install -m 644 "$project/LICENSE" "$root/usr/share/doc/motord/copyright"
install -m 755 "$here"/deb/{postinst,prerm,postrm} "$root/DEBIAN/"
# what TAB completes, and man pages: both from the commands' own help
for shell in bash:bash-completion/completions/motord zsh:zsh/vendor-completions/_motord \
    fish:fish/vendor_completions.d/motord.fish; do
    install -d "$root/usr/share/$(dirname "${shell#*:}")"
    "$python" -m motord completion "${shell%%:*}" >"$root/usr/share/${shell#*:}"
done
"$python" -m motord.cli.man "$root/usr/share/man/man1"
gzip -9 -n "$root"/usr/share/man/man1/*.1
size=$(du -sk --exclude=DEBIAN "$root" | cut -f 1)
sed -e "s/@VERSION@/$version/; s/@ARCHITECTURE@/$architecture/; s/@SIZE@/$size/" \
    -e "s/@PYTHON@/$minor/; s/@NEXT@/$next/" \
    "$here/deb/control" >"$root/DEBIAN/control"
find "$root" -type d -exec chmod 755 {} +
dpkg-deb --build --root-owner-group -Zgzip -z1 "$root" "$package" >&2
echo "$state" >"$dir/made.txt"
echo "$package"

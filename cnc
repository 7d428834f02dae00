#!/usr/bin/env bash
# Runs cnc_interp from a checkout and sets up everything it needs on first use, in .venv.
#
#   ./cnc run [PROGRAM ...]   stream a part program through the ROS 2 nodes to the simulated
#                             machine; without PROGRAM the bundled examples/pyramid.ngc
#   ./cnc panel [PROGRAM]     the operator page in a browser, with a simulated machine behind it
#   ./cnc test                the tests that every change must pass
#   ./cnc test --share        the same, and the share of the thorough tests whose turn it is
#   ./cnc test --all          all tests, a build with colcon and a bare system; before a release
#   ./cnc test ARGUMENTS      arguments go to pytest: ./cnc test -x test/unit/test_cli.py
#   ./cnc lint                ruff and mypy
#   ./cnc docs                all pages and the API as a site, out/site
#   ./cnc setup               only set up, check all of it, repair what is broken
#   ./cnc COMMAND ...         any other command of cnc-interp (./cnc --help lists them)
set -euo pipefail

root=$(dirname -- "$(readlink -f -- "${BASH_SOURCE[0]}")")
venv=$root/.venv
stamp=$venv/.ready # what the environment was made from; an environment without it is unfinished

say() { printf 'cnc: %s\n' "$*" >&2; }
fail() { say "$*"; exit 1; }

# One line per part of the environment: its name and the hash of the files it is made from.
fingerprints() (
  cd "$root"
  for part in "$@"; do
    case $part in
      base) set -- requirements/{ros-jazzy,build,source,run}.txt ;;
      project) set -- setup.py setup.cfg ;;
      messages) set -- msg_defs/CMakeLists.txt msg_defs/package.xml msg_defs/*/* ;;
      test | docs | panel | step | batch | tiles | mtconnect) set -- "requirements/$part.txt" ;;
    esac
    sum=$(sha256sum "$@" | sha256sum)
    printf '%s %s\n' "$part" "${sum%% *}"
  done
)

# True when the environment is finished, belongs to this checkout, its Python runs, and no installed
# file is missing. Takes some hundredths of a second.
sound() {
  local kind value
  [ -s "$stamp" ] || return 1
  while read -r kind value; do
    case $kind in
      root) [ "$value" = "$root" ] || return 1 ;;
      python) "$venv/bin/python" -I -S -c "import sys; sys.exit(sys.version[:4] != '$value')" \
        2>/dev/null || return 1 ;;
      file) [ -s "$venv/$value" ] || return 1 ;;
    esac
  done <"$stamp"
}

# True when every part named is made from the files as they are now.
current() {
  local line
  while read -r line; do
    grep -qxF "$line" "$stamp" || return 1
  done < <(fingerprints "$@")
}

ensure() {
  if ! { sound && current "$@"; }; then
    # shellcheck source=tools/environment.sh
    . "$root/tools/environment.sh"
    make_environment "$@"
  fi
}

# Removes another ROS 2, or another environment of the same wheels, from the variables of a shell.
leave_other_ros() {
  if [ -n "${AMENT_PREFIX_PATH-}${_ROS_WHEELS_BOOTSTRAP_COMPLETE-}" ]; then
    unset AMENT_PREFIX_PATH CMAKE_PREFIX_PATH COLCON_PREFIX_PATH PYTHONPATH LD_LIBRARY_PATH
    unset _ROS_WHEELS_BOOTSTRAP_COMPLETE
  fi
  export AMENT_PREFIX_PATH=$venv RMW_IMPLEMENTATION=rmw_fastrtps_cpp
  [ -w "${HOME-}" ] || export ROS_LOG_DIR="${ROS_LOG_DIR:-$venv/log}"
}

# What --all tries beside pytest: a build with colcon, a bare system, LinuxCNC's interpreter.
try_everything_else() {
  local workspace
  workspace=$(mktemp -d)
  tools/colcon_check "$workspace"
  rm -rf "$workspace"
  tools/bare_system --tests
  tools/bare_system --pip
  if RS274=$(tools/get_rs274 "$venv/linuxcnc"); then export RS274; fi
}

lint() {
  local clean=0
  cd "$root"
  "$venv/bin/ruff" check . || clean=1
  "$venv/bin/ruff" format --check . || clean=1
  "$venv/bin/mypy" || clean=1
  return "$clean"
}

main() {
  local parts=(base project messages)
  unset PYTHONDONTWRITEBYTECODE # without compiled imports every start takes seconds longer
  trap 'say interrupted; exit 130' INT
  leave_other_ros
  case ${1-} in
    test)
      shift
      parts+=(test panel step batch tiles mtconnect)
      case " $* " in *' --all '*) parts+=(docs) ;; *' --share '*) parts+=(docs) ;; esac
      ensure "${parts[@]}"
      cd "$root"
      case " $* " in *' --all '*) try_everything_else ;; esac
      # Side by side where nothing is named: a test alone says more, and can be debugged.
      local word workers=(-n auto --maxprocesses 4)
      for word in "$@"; do
        case $word in --all | --share | -q | -x | --*=*) ;; *) workers=() ;; esac
      done
      exec "$venv/bin/python" -m pytest "${workers[@]}" "$@"
      ;;
    lint)
      ensure "${parts[@]}" test
      lint
      ;;
    docs)
      venv=$root/.venv-docs # mkdocs reads the sources, so it needs no ROS and no kernels
      # shellcheck source=tools/environment.sh
      . "$root/tools/environment.sh"
      make_docs_environment
      cd "$root"
      exec "$venv/bin/mkdocs" build --quiet
      ;;
    setup)
      ensure "${parts[@]}"
      # shellcheck source=tools/environment.sh
      . "$root/tools/environment.sh"
      check_environment >/dev/null || remake_environment "${parts[@]}"
      compile_kernels || true
      say "ready: $venv"
      ;;
    '' | help)
      sed -n '2,/^set/{/^#/s/^# \{0,1\}//p}' "${BASH_SOURCE[0]}"
      ;;
    *)
      [ "$*" != run ] || set -- run "$root/examples/pyramid.ngc"
      [ "$*" != panel ] || set -- panel "$root/examples/pyramid.ngc"
      case " $* " in ' panel '* | *' --panel '*) parts+=(panel) ;; esac
      case $1 in batch | cluster) parts+=(batch) ;; mtconnect) parts+=(mtconnect) ;; esac
      case " $* " in ' cam '*' --tiles'*) parts+=(tiles) ;; esac
      case " $* " in ' cam '*' --scheduler'*) parts+=(batch) ;; esac
      case " ${*,,} " in ' cam '*.step' '* | ' cam '*.stp' '* | ' cam '*.p21' '*) parts+=(step) ;; esac
      ensure "${parts[@]}"
      # Ctrl-C waits until Python is up; before, it would be a traceback.
      exec env --block-signal=INT "$venv/bin/cnc-interp" "$@"
      ;;
  esac
}

main "$@"

# Words that may follow on a command line of modelgap, one a line: the arguments are its
# words, the one at the cursor last. Status 0: files may stand there too. POSIX shell,
# so that bash, zsh and fish ask the same function and no Python starts.
_modelgap_offer() (
  [ -z "${ZSH_VERSION:-}" ] || emulate sh
  IFS=" " store=${MODELGAP_STORE:-store} command= previous= names= ids= files=0
  while [ $# -gt 1 ]; do
    case $previous:$1 in
      *:=) shift && continue ;; # bash parts --store=FOLDER
      *:--store=*) store=${1#--store=} ;;
      --store:*) store=$1 ;;
      *:-*) ;;
      *) case $command in '' | @GROUPS@) command="${command:+$command }$1" ;; esac ;;
    esac
    previous=$1
    shift
  done
  case $command in
@COMMANDS@
  *) flags= ;;
  esac
  case $previous in @VALUES@) names= ids= ;; esac
  case "$command $previous" in
@CHOICES@
  esac
  case $1 in -*) names=$flags ids= files=1 ;; esac
  for word in $names; do
    case $word in "$1"*) printf '%s\n' "$word" ;; esac
  done
  for kind in $ids; do
    case $kind in
      run) set -- "$1" "$store"/samples/robot=*/run_id="$1"* ;;
      *) set -- "$1" "$store"/*/"$kind"_id="$1"* ;;
    esac
    at=$1
    shift
    for place; do
      [ ! -d "$place" ] || printf '%s\n' "${place##*=}"
    done
    set -- "$at"
  done
  return $files
)

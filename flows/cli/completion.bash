@OFFER@
_modelgap() {
  local IFS=$'\n' offered files at=${COMP_WORDS[COMP_CWORD]}
  offered=$(_modelgap_offer "${COMP_WORDS[@]:1:COMP_CWORD}"); files=$?
  COMPREPLY=($offered)
  [ $files -ne 0 ] || COMPREPLY+=($(compgen -f -- "$at"))
}
complete -o default -o filenames -F _modelgap modelgap

#compdef modelgap
@OFFER@
_modelgap() {
  local files offered
  offered=$(_modelgap_offer "${(@)words[2,CURRENT]}"); files=$?
  [[ -z $offered ]] || compadd -- ${(f)offered}
  [[ $files -ne 0 ]] || _files
}
_modelgap "$@"

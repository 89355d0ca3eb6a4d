function __modelgap_offer
    set -l words (commandline -opc) (commandline -ct)
    if sh -c '@QUOTED@
_modelgap_offer "$@"' modelgap $words[2..]
        __fish_complete_path (commandline -ct)
    end
end
complete -c modelgap -f -a '(__modelgap_offer)'
